"""Commands for recorded data: `info` and `replay`."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pcbench.cli.options import Json, Late, Quiet, Set, Start
from pcbench.cli.shared import (
    argument,
    console,
    names,
    option,
    out,
    require_effect,
    say,
    setup,
    show_progress,
    write,
    write_new,
)
from pcbench.errors import UserError, short

if TYPE_CHECKING:
    from pcbench.recordings.log import Log

FROM = "from:"  # as in studies
File = Annotated[
    str,
    argument("Recording: a folder or file of tables, or a TOML file that maps its fields to channels", metavar="LOG"),
]


def info(
    file: Annotated[str, argument("A recording of any format, or a TOML file that maps its fields to channels")],
    delay: Late = None,
    picture: Annotated[
        str | None, out("File for a figure of the delays (.svg, .pdf, .png), or the file of --toml")
    ] = None,
    toml: Annotated[bool, option("Print a TOML file to start from, which maps fields to channels", "--toml")] = False,
    as_json: Json = False,
) -> None:
    """Show what a recording contains: rates, gaps, delays, lags, out-of-sequence or repeated samples, clock skew.

    For a file without a TOML file it prints topics, fields, counts, rates and ranges.

    Examples: pcbench info flight.bag;  pcbench info flight.bag --toml --out flight.toml;  pcbench info flight.toml
    """
    from pcbench.cli.render import recordings
    from pcbench.cli.render.tables import to_json
    from pcbench.recordings import contents, survey

    path = Path(file)
    if contents.is_log(path):
        require_effect({"--toml": toml}, "with a recording whose channels are known", "a file without a TOML file")
    else:
        require_effect(
            {"--delay": delay, "--out": None if toml else picture, "--json": toml and as_json},
            "with a file without channels",
            "a TOML file (pcbench info FILE --toml writes one)",
        )
        topics = contents.contents(path)
        if toml:
            text = contents.starter_toml(path, topics, Path(picture or "x").absolute().parent)
            write(text) if picture is None else write_new(Path(picture), text, "--out")
            say(*(f"{path.name}: {c.problem}" for c in topics if c.problem))
        elif as_json:
            print(to_json({"log": file, "fields": contents.rows_of(topics)}))
        else:
            recordings.print_contents(
                file, contents.rows_of(topics), [c.problem for c in topics if c.problem], console()
            )
        return
    table = survey.info(file, delay=delay)
    if picture is not None:
        from pcbench.plots import delays, save

        save(delays(table), picture)
    if as_json:
        lags = [lag._asdict() for lag in table.attrs["lags"]]
        print(to_json({"log": file, "channels": table.to_dict("records"), "lags": lags}))
    else:
        recordings.channels(table, console())
        if picture is not None:
            print(f"Figure of the delays over time and of their distribution: {picture}")


def convert(
    file: File,
    folder: Annotated[str, out("Folder for the new recording")],
    thin: Annotated[int, option("Keep every n-th measurement of each channel", min=1)] = 1,
    delay: Annotated[
        str | None, option("Delay of every measurement [s], or from:LOG to draw delays from a recording")
    ] = None,
    truth: Annotated[
        str | None, option("Names of the states that the channels measure [default: the channels' own]")
    ] = None,
    seed: Annotated[int, option("Seed of the delays that are drawn", min=0)] = 0,
) -> None:
    """Make a slow, delayed recording from a fast one; all measurements of the fast one become the truth.

    Example: pcbench convert encoder.csv.toml --thin 10 --delay from:camera --truth angle --out slow
    """
    import numpy as np

    from pcbench.dataset import parquet_io, storage
    from pcbench.recordings import readers, survey, thinning

    place = Path(folder)
    if place.exists() and (not place.is_dir() or any(place.iterdir())):
        raise UserError(f"--out {folder}: is there already, expected a new or empty folder; give another.")
    log = _open(file, delay)
    survey.survey(log)  # raises UserError for unusable rows and clocks
    delays = None
    if delay is not None and delay.startswith(FROM):
        delays = thinning.delays_of(readers.open_log(delay.removeprefix(FROM)), log.channels)
    elif delay is not None:
        delays = dict.fromkeys(log.channels, np.array([_seconds(delay)]))
    tables = thinning.thin_tables(log, thin, delays, None if truth is None else names(truth), seed)
    target = storage.target(folder)
    storage.create_folder(target)
    storage.write_files(target, {f"{name}.parquet": parquet_io.encode_table(table) for name, table in tables.items()})
    print(f"{folder}: {len(tables['measurements']):,} measurements of {', '.join(log.channels)}")


def _open(file: str, delay: str | None) -> "Log":
    """Return the log of a file; it needs no arrival times if a delay replaces them."""
    from pcbench.recordings import readers

    if delay is not None:
        with suppress(UserError):
            return readers.open_log(file, 0.0)
    return readers.open_log(file)


def _seconds(text: str) -> float:
    """Return a delay [s]; raise UserError if it is not a number."""
    with suppress(ValueError):
        if 0 <= (number := float(text)) < float("inf"):
            return number
    raise UserError(f"--delay: got '{short(text)}', expected seconds or {FROM}LOG; write 0.05 or {FROM}camera.")


def replay(
    file: File,
    plant: Annotated[str, option("Study with one scenario, whose outputs are the channels of the recording")],
    observers: Annotated[str, option("Comma-separated names of observers, or all (that support the plant)")],
    folder: Annotated[str, out("Folder for the estimates and their statistics")],
    delay: Late = None,
    start: Start = None,
    seed: Annotated[int, option("Seed of observers that use random numbers")] = 0,
    changes: Set = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run observers on a recording, with each measurement at its arrival, and test their innovations.

    Example: pcbench replay flight.toml --plant motor.toml --observers kf,pccebo,ukf --out replayed
    """
    setup()
    from pcbench.cli.render import recordings
    from pcbench.cli.render.tables import to_json
    from pcbench.playback import replay

    with show_progress(quiet or as_json, "reading the recording") as progress:
        result = replay.replay(
            file,
            plant,
            names(observers),
            out=folder,
            delay=delay,
            start=start,
            seed=seed,
            overrides=changes,
            progress=progress,
        )
    if as_json:
        print(to_json(result.summary | {"out": folder}))
        return
    say(*result.summary["notes"])
    if quiet:
        print(folder)
    else:
        recordings.print_replay(result, folder, console())
