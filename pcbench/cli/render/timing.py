"""What a run took, in a sentence or line by line."""

from pcbench.dataset.result import Result


def sentence(result: Result, folder: str) -> str:
    """Return what a run took, in a sentence."""
    p = result.provenance
    if not result.cost.runs and result.exact and not p["blocks"]:
        cells = result.stats.groupby(["scenario", "cell"]).ngroups
        return f"Exact numbers of {'one cell' if cells == 1 else f'{cells:,} cells'} are in {folder}."
    if result.study.evaluation == "exact" and not result.exact and p["blocks"] and result.stats.reason.isna().any():
        return (
            f"The tables in {folder} are of its runs, which stay; exact moments stand beside them: hold them together with "
            f"pcbench verify {folder} --exact, or give another folder with --out for tables of exact numbers."
        )
    if result.study.evaluation == "exact" and not result.exact:
        return f"No number in {folder} is exact: its tables say why, in the column reason of stats."
    if not result.cost.runs:
        return f"Nothing was left to do: {p['blocks']} blocks in {folder}."
    spent = f"{p['wall_seconds']:.1f} s ({p['compile_seconds']:.1f} s compiling, {p['writing_seconds']:.1f} s writing)"
    return f"{p['runs_added']:,} runs added; {p['blocks']} blocks and their statistics in {folder} after {spent}."


def timings(result: Result, seconds: float) -> list[str]:
    """Return where the time of a run went, a line each; `seconds` since the command began."""
    p = result.provenance
    if not result.cost.runs and not result.cost.exact_seconds:
        return []
    before = max(seconds - p["wall_seconds"], 0.0), "imports, reading, designs that are tuned"
    rows = {"from the command to the study": before}
    if result.cost.exact_seconds:
        rows["exact numbers"] = result.cost.exact_seconds, "planning, solving and writing them"
    if not result.cost.runs:
        rows["the study in all"] = p["wall_seconds"], ""
        return _took(rows)
    rows |= {
        "planning": (p["planning_seconds"], "designs, schedules, bounds"),
        "computing": (p["computing_seconds"], f"on all threads, {p['compile_seconds']:.1f} s of it making programs"),
        "writing": (p["writing_seconds"], "on all threads"),
        "closing tables, beside": (p["closing_seconds"], "while others compute"),
        "the study in all": (p["wall_seconds"], f"{p['runs_added']:,} runs"),
    }
    return _took(rows)


def _took(rows: dict[str, tuple[float, str]]) -> list[str]:
    return [f"{what:<30}{took:9.2f} s   {how}".rstrip() for what, (took, how) in rows.items()]
