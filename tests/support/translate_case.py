"""Turn commands, TOML, Python and C from the names of before 0.1.0 into those of 0.1.0: `python translate_case.py PATH ...`.

Each file is rewritten in place. A name of one meaning (`dkf`) is replaced wherever it is a word; a word that is plain English
too (`drift`) only as a name: a key, a keyword, an attribute of a record, a quoted word, an option's value. Names that a file
gives to things of its own are left as they are, so read what comes out.
"""

import argparse
import re
import sys
from pathlib import Path

START, END = r"(?:(?<![A-Za-z0-9])|(?<=\\n))", r"(?![A-Za-z0-9])"  # after a line break that is written \n, too

WORDS = {
    # observers, their labels, a scenario
    "dkf": "kf",
    "DKF": "KF",
    "iekf": "ekf-iterated",
    "open-loop": "model-only",
    "kf-now": "kf-ignore-delay",
    "kf-discard": "kf-drop-delayed",
    "kf-shift": "kf-shifted-innovation",
    "kf-rewind": "kf-reprocess",
    "kf-horizon": "kf-delayed-horizon",
    "bank-blind": "mmae-delay-blind",
    "ekf-doubts": "ekf-inflated-q",
    "as-believed": "as-assumed",
    # fields of a scenario
    "stamp_offset": "timestamp_offset",
    "stamp_drift": "clock_skew",
    "stamp_jitter": "timestamp_jitter",
    "delay_steps": "delay_values",
    "delay_stay": "delay_self_transition",
    "delay_share": "delay_weights",
    "delay_turns": "delay_sequence",
    "delay_swing": "delay_sine",
    "delay_gamma": "delay_gamma_mean",
    "delay_shape": "delay_gamma_shape",
    "noise_tail": "student_t_dof",
    "random_start": "random_initial_state",
    "random-start": "random-initial-state",
    "start_spread": "initial_spread",
    "start-spread": "initial-spread",
    "start_box": "initial_box",
    # metrics and columns
    "tail_cost": "steady_lq_cost",
    "tail_peak": "steady_max_abs_error",
    **{
        f"tail_{name}": f"steady_{name}"
        for name in ("mae", "mse", "rmse", "squares", "tracking_rmse", "input_rms", "pooled_rmse")
    },
    "tail_pooled_tracking_rmse": "steady_pooled_tracking_rmse",
    "tail_pooled_input_rms": "steady_pooled_input_rms",
    "nis_degrees": "nis_dof",
    "nees_states": "nees_dof",
    "carries_input": "predicts_unknown_input",
    "first_bad_time": "divergence_time",
    "p_white": "ljung_box_p",
    "p white": "ljung_box_p",
    "less the best": "diff. to best",
    "over-confident": "optimistic",
    **{f"inside_{k}_sigma": f"coverage_{k}_sigma" for k in (1, 2, 3)},
}
NAMES = {  # that are words of English too
    "bank": "mmae-delay",
    "jitter": "sampling_jitter",
    "resolution": "quantization_step",
    "burst": "mean_burst_length",
    "horizon": "duration",
    "early": "prefilled",
    "drift": "parameter_drift",
    "tail": "steady_start",
    "profile": "sampling_pattern",
    "peak": "max_abs_error",
    "final": "final_error",
    "efficiency": "rms_efficiency",
    "divergence": "divergence_rate",
    "unsettled": "unsettled_rate",
    "cost": "lq_cost",
    "bound": "divergence_threshold",
    "cautious": "pessimistic",
}
VALUES = {  # of keys of a study
    ("vary", "each"): "one-at-a-time",
    ("tuning", "paper"): "published",
}
WHERE = {  # names whose meaning depends on what stands before them in the line: (before, old) -> new
    (r"pcbench run ", "--exact"): "--evaluation exact",
    (r"pcbench design ", "--method"): "--gain",
    (r"pcbench tune ", "--method"): "--optimizer",
    (r"pcbench tune ", "--exact"): "--exact-objective",
    (r"\brun\(", "method="): "evaluation=",
    (r"\brun\(", "block="): "block_size=",
    (r"\b(?:run|suffices|find_limit)\(", "fresh="): "overwrite=",
    (r"\b(?:design|trade_off)\(", "method="): "gain=",
    (r"\btune\(", "method="): "optimizer=",
    (r"\btune\(", "exact="): "exact_objective=",
    (r"\btune\(", "training="): "training_seeds=",
    (r"\btune\(", "judges="): "validation_seeds=",
    (r"\b(?:suffices|find_limit)\(", "over="): "axis=",
    (r"\b(?:suffices|find_limit)\(", "below="): "threshold=",
    (r"\b(?:suffices|find_limit)\(", "within="): "tol=",
    (r"\bObserver\(", "note="): "snapshot=",
    (r"\bObserver\(", "sampled="): "on_sample=",
    (r"\bObserver\(", "seeded="): "init_random=",
    (r"\barrival", ".note"): ".snapshot",
    (r"\barrival", ".fresh"): ".mask",
    (r"\barrival", ".since"): ".ticks_since_arrival",
    (r"^", 'method = "exact"'): 'evaluation = "exact"',
    (r"^", 'method = "both"'): 'evaluation = "both"',
}
OF_OBSERVERS = {  # options, by the new name of the observer
    "kf-drop-delayed": {"limit": "max_age"},
    "kf-delayed-horizon": {"horizon": "lag", "duration": "lag"},
}
STUDIES = {  # after `pcbench COMMAND`, in `pcbench.run("...")`, as a folder of results/
    "beliefs": "model-mismatch",
    "faults": "measurement-errors",
    "fair-reactor": "equal-tuning-reactor",
    "fair": "equal-tuning",
    "late": "delayed-measurements",
    "map": "period-delay-map",
}
COMMANDS = {
    "suffices": "find-limit",
    "log": "info",
    "draws": "external prepare",
    "guest": "external run",
    "score": "external score",
    "trace": "simulate",
}
OPTIONS = {
    "--fresh": "--overwrite",
    "--below": "--threshold",
    "--over": "--axis",
    "--within": "--tol",
    "--kinds": "--formats",
    "--block": "--block-size",
    "--cell": "--grid-point",
    "--costs": "--operations",
    "--judge": "--validation-seeds",
    "--train": "--training-seeds",
}
FUNCTIONS = {
    "suffices": "find_limit",
    "trace": "simulate",
    "exact": "exact_moments",
    "log": "info",
    "costs": "operation_counts",
    "opened": "open_result",
    "together": "vmap_as_unit",
    "plant": "make_plant",
    "certified": "require_certified",
    "uncertified": "no_certificate",
}
TYPES = {
    "Surprise": "InnovationStats",
    "Told": "ControllerContext",
    "Setting": "DesignContext",
    "Entry": "ObserverSpec",
    "PlantEntry": "PlantSpec",
    "ControllerEntry": "ControllerSpec",
    "held": "discretize_zoh",
}
IN_C = {"note": "snapshot", "fresh": "mask", "since": "ticks_since_arrival"}  # of what arrives, `a`
RECORDS = r"(?:scenario|axes|lti|sampling|scoring|truth|options\.\w+)"


def translate(text: str) -> str:
    """Return a text with the names of 0.1.0."""
    for old, new in WORDS.items():
        after = r"(?!_mean|_shape)" if old == "delay_gamma" else ""
        text = re.sub(f"{START}{old}{END}{after}", new, text)
    for old, new in NAMES.items():
        for where in (
            rf"(?<=[\"'`]){old}(?=[\"'`\[]|=\S)",  # quoted, or the key of a quoted KEY=VALUE
            rf"(?<![\w-])(?<=--metric ){old}{END}",
            rf"(?<=--over ){old}{END}",
            rf"(?<=--axis ){old}{END}",
            rf"(?<=[(,\s]){old}(?==[^=\s])",  # a keyword, KEY=VALUE on a command line
            rf"(?:^|(?<=\\n)){old}(?= = )",  # a key of TOML
            rf"(?<=\"){old}(?= = )",
            rf"(?<=^\[options\.){old}(?=\])",
        ):
            text = re.sub(where, new, text, flags=re.MULTILINE)
        text = re.sub(rf"(--observers? (?:[\w-]+,)*){old}(?![\w-])", rf"\g<1>{new}", text)
        text = re.sub(rf"(?<![\w.])({RECORDS}\.){old}(?=[=\s\"'`\[])", rf"\g<1>{new}", text)
    for observer, options in OF_OBSERVERS.items():
        for old, new in options.items():
            text = re.sub(rf"({observer}\.){old}{END}", rf"\g<1>{new}", text)
            text = re.sub(rf"({observer}\"?:? ?=? ?{{ ?\"?){old}{END}", rf"\g<1>{new}", text)
            text = re.sub(
                rf"(\[(?:options|observers)\.{observer}\]\n(?:\w+ = .*\n)*?){old}(?= = )", rf"\g<1>{new}", text
            )
    for (key, old), new in VALUES.items():
        text = re.sub(rf"({key}\"?(?:=|: | = )\[?(?:\".*\", )?\"){old}(?=\")", rf"\g<1>{new}", text)
    for old, new in STUDIES.items():
        text = re.sub(rf"(pcbench \w+ |pcbench\.\w+\(\"|results/){old}(?![\w-])", rf"\g<1>{new}", text)
    for old, new in COMMANDS.items():
        text = re.sub(rf"(?<=pcbench ){old}(?![\w-])", new, text)
    for old, new in OPTIONS.items():
        text = re.sub(rf"(?<![\w-]){old}(?![\w-])", new, text)
    text = re.sub(r"pcbench\.tune_log\(([^,()]+), ([^,()]+), ([^,()]+)", r"pcbench.tune(\2, \3, log=\1", text)
    for old, new in FUNCTIONS.items():
        text = re.sub(rf"(?<=\bpcbench\.){old}(?=\()", new, text)
    for old, new in TYPES.items():
        text = re.sub(rf"(?<=\bpcbench\.){old}{END}", new, text)
    for (before, old), new in WHERE.items():
        between = r"[^\n|`]*?" if before.endswith((" ", "(")) else ""
        pattern = rf"({before}{between}){'' if old[0] in '.m' and not between else '(?<![A-Za-z0-9-])'}{re.escape(old)}"
        text = re.sub(
            pattern + ("" if old.endswith(("=", '"')) else r"(?![\w-])"), rf"\g<1>{new}", text, flags=re.MULTILINE
        )
    for old, new in IN_C.items():
        text = re.sub(rf"(?<=\ba\.){old}(?= (?:=|\[)|\[)", new, text)
    return re.sub(r"\b(\w+)_note\(", r"\1_snapshot(", text)


def main() -> int:
    """Rewrite the files that are named, and those of named folders that hold text; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("where", nargs="+", type=Path, help="files, or folders such as a copy of a case")
    for place in parser.parse_args().where:
        for path in sorted(each for each in place.rglob("*") if each.is_file()) if place.is_dir() else [place]:
            try:
                before = path.read_text(encoding="utf-8")
            except UnicodeDecodeError:
                if path == place:
                    parser.error(f"{path} is no text in UTF-8; name files with commands, TOML, Python or C")
                continue
            if (after := translate(before)) != before:
                path.write_text(after, encoding="utf-8")
                print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
