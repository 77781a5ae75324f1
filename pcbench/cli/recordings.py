"""Commands for recorded data: what is in a log, and observers run on it."""

from pathlib import Path
from typing import Annotated

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
    working,
    write,
    write_new,
)

File = Annotated[str, argument("a folder or file of tables, or a TOML that says what a bag holds", metavar="LOG")]


def info(
    file: Annotated[str, argument("a recording of any format, or a TOML file that maps its fields to channels")],
    delay: Late = None,
    picture: Annotated[
        str | None, out("picture of the delays to write (.svg, .pdf, .png), or the file of --toml")
    ] = None,
    toml: Annotated[bool, option("print a TOML file to start from, that maps fields to channels", "--toml")] = False,
    as_json: Json = False,
) -> None:
    """Print what is in a recording: rates, gaps, delays, samples out of order or doubled, stamps that jump or drift.

    Of a file without a TOML file it prints topics, fields, counts, rates and ranges.

    Examples: pcbench info flight.bag;  pcbench info flight.bag --toml --out flight.toml;  pcbench info flight.toml
    """
    from pcbench.cli.render import recordings
    from pcbench.cli.render.tables import readable
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
        elif as_json:
            print(readable({"log": file, "fields": contents.rows_of(topics)}))
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
        print(readable({"log": file, "channels": table.to_dict("records")}))
    else:
        recordings.channels(table, console())
        if picture is not None:
            print(f"delays over time, and how often each occurs: {picture}")


def replay(
    file: File,
    plant: Annotated[str, option("a study of one scenario: its outputs are the log's channels")],
    observers: Annotated[str, option("comma-separated names, or all that can run")],
    folder: Annotated[str, out("folder for the estimates and what is known of them")],
    delay: Late = None,
    start: Start = None,
    seed: Annotated[int, option("of observers that draw numbers themselves")] = 0,
    changes: Set = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Run observers on what was measured, when it arrived, and say what can be known of them.

    Example: pcbench replay flight.toml --plant motor.toml --observers kf,pccebo,ukf --out replayed
    """
    setup()
    from pcbench.cli.render import recordings
    from pcbench.cli.render.tables import readable
    from pcbench.playback import replay

    with working(quiet or as_json, "reading the log") as progress:
        found = replay.replay(
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
        print(readable(found.summary | {"out": folder}))
        return
    say(*found.summary["said"])
    if quiet:
        print(folder)
    else:
        recordings.print_replay(found, folder, console())
