"""What differs between a study on disk and one that is to go on there: phrases for a refusal. No jax."""

from typing import Any

from pcbench.dataset.seeds import common, counted

GROWS = ("seeds", "first_seed", "axes", "observers", "scenarios", "options", "lti", "resolved")


def changes(there: dict[str, Any], here: dict[str, Any]) -> Any:
    """Yield what differs between a study on disk and one that is to go on there, a phrase each."""
    for key in sorted((there.keys() | here.keys()) - set(GROWS)):
        if there.get(key) != here.get(key):
            yield _phrase(key, there.get(key), here.get(key))
    a, b = (counted(study["first_seed"], study["seeds"]) for study in (there, here))
    if common(a, b) != a:
        yield f"seeds: {a.first} .. {a.stop - 1} there, {b.first} .. {b.stop - 1} here"
    old, new = there["resolved"], here["resolved"]
    for scenario, names in old["observers"].items():
        if scenario not in new["observers"]:
            yield f"scenarios: {scenario} there, not here"
            continue
        for name in names:
            if name not in new["observers"][scenario]:
                yield f"observers: {name} there, not here"
        yield from _deep(f"options of {scenario}", old["options"].get(scenario, {}), new["options"][scenario], names)
        yield from _deep(scenario, old["scenarios"].get(scenario, {}), new["scenarios"][scenario])
    yield from _deep("options.scenario", old["options"]["scenario"], new["options"]["scenario"])
    yield from _lost(there, here)


def _lost(there: dict[str, Any], here: dict[str, Any]) -> Any:
    """Yield the axes that have lost a value or come anew where cells were lost."""
    old, new = there["resolved"].get("cells", {}), here["resolved"].get("cells", {})
    if any(set(old[s]) - set(new.get(s, [])) or len(set(new.get(s, []))) < len(old[s]) for s in old):
        axes, found = (there.get("axes", {}), here.get("axes", {})), []
        for name in sorted(axes[0].keys() | axes[1].keys()):
            a, b = (each.get(name) for each in axes)
            if a is None or b is None or any(v not in b for v in a):
                found.append(_phrase(f"axes.{name}", a, b))
        yield from found or ["cells: some that stand there are not of this study"]


def _deep(where: str, old: dict[str, Any], new: dict[str, Any], names: list[str] | None = None) -> Any:
    for key in sorted(names if names is not None else old.keys() | new.keys()):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            yield from _deep(f"{where}.{key}", a, b)
        elif a != b:
            yield _phrase(f"{where}.{key}", a, b)


def _phrase(where: str, there: Any, here: Any) -> str:
    say = ["nothing" if v is None else repr(v) if len(repr(v)) < 60 else repr(v)[:57] + "..." for v in (there, here)]
    return f"{where}: {say[0]} there, {say[1]} here"
