"""Observers of a study are told apart: by readers of normal sight, by those who lack a kind of cone, and on grey paper."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

import pcbench
from pcbench.observers import OBSERVERS, base_of
from pcbench.plots import palette
from pcbench.study import STUDIES, observers_of

# How colours are seen, by linear RGB. Source: Machado, Oliveira, Fernandes 2009, table 1, severity 1.
SIGHT = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
GROUPS = sorted({tuple(observers_of(study, s)) for study in STUDIES.values() for s in study.scenarios})


def linear(colour):
    parts = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    return np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)


def lab(colour, sight="normal"):
    """CIE L*a*b* of a colour as it is seen."""
    seen = XYZ @ np.clip(np.array(SIGHT[sight]) @ linear(colour), 0, 1) / [0.95047, 1.0, 1.08883]
    f = np.where(seen > 0.008856, np.cbrt(seen), 7.787 * seen + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def apart(a, b):
    return min(np.linalg.norm(lab(a, sight) - lab(b, sight)) for sight in SIGHT)


def test_every_observer_has_a_look_of_its_own_that_is_seen_on_white():
    assert set(palette.LOOKS) == set(OBSERVERS)
    colours = [look.colour for look in palette.LOOKS.values()]
    for colour in colours:
        assert (1.05 / (XYZ[1] @ linear(colour) + 0.05)) > 2.4, colour
    for a, b in itertools.combinations(colours, 2):
        assert apart(a, b) > 8, (a, b)


@pytest.mark.parametrize("base", OBSERVERS)
def test_every_shade_of_an_observer_is_seen_on_white(base):
    """Lines of mhe-bounded and of pio-reconstruct were pale: a light colour mixed with white."""
    for style in palette.styles([base, *(f"{base}-{label}" for label in "abcd")]).values():
        assert (1.05 / (XYZ[1] @ linear(style.colour) + 0.05)) > 2.4, style


@pytest.mark.parametrize("group", GROUPS, ids=", ".join)
def test_observers_that_run_together_are_told_apart_in_colour_and_on_grey_paper(group):
    look = palette.styles(group)
    for a, b in itertools.combinations(group, 2):
        one, two = look[a], look[b]
        same = base_of(a) == base_of(b)
        assert apart(one.colour, two.colour) > (10 if same else 15), (a, b)
        assert abs(lab(one.colour)[0] - lab(two.colour)[0]) > 5 or one.dash != two.dash, (a, b)
        assert one.marker != two.marker, (a, b)
        assert one.dash != two.dash, (a, b)


def test_a_label_keeps_its_look_whatever_stands_beside_it():
    alone = palette.styles(["kf"])["kf"]
    assert palette.styles(["kfbo", "kf", "kf-bias"])["kf"] == alone
    three = palette.styles(["pccebo-published", "pccebo-design", "pccebo-tuned"])
    assert len({s.colour for s in three.values()}) == len({s.dash for s in three.values()}) == 3
    assert palette.styles(["kfbo", "kf-bias"])["kf-bias"].colour == palette.LOOKS["kf"].colour


def test_a_variant_has_the_hue_of_its_base():
    look = palette.styles(["chain", "chain-slow", "chain-riccati", "kf", "kf-bias"])
    for label in ("chain-slow", "chain-riccati", "kf-bias"):
        base = lab(look[label.split("-")[0]].colour)[1:]
        mine = lab(look[label].colour)[1:]
        turned = np.degrees(np.arccos(base @ mine / np.linalg.norm(base) / np.linalg.norm(mine)))
        assert turned < 25, label


def test_words_are_read_on_every_colour_and_its_pale_form():
    for colour in (look.colour for look in palette.LOOKS.values()):
        for ground in (colour, palette.pale(colour)):
            light, ink = (XYZ[1] @ linear(c) for c in (ground, palette.ink_on(ground)))
            assert (max(light, ink) + 0.05) / (min(light, ink) + 0.05) > 3.4, ground


def test_the_interactive_figure_draws_every_marker():
    """A marker without a path was drawn as nothing: that of finite-time."""
    script = (Path(pcbench.__file__).parent / "report" / "explorer.js").read_text()
    table = script.partition("const MARKERS = {")[2].partition("};")[0]
    drawn = set(re.findall(r"(?:^|[\s,])[\"']?([\w^<>*])[\"']?: ", table)) | {"x"}
    assert {style.marker for style in palette.LOOKS.values()} | set(palette.SIBLINGS) <= drawn


def test_styles_do_not_depend_on_the_order_of_labels():
    """A figure in the order of ranks has the colours of one in the order of the study."""
    labels = ["kf", "pccebo-riccati", "pccebo-loose", "kf-bias"]
    assert palette.styles(labels) == palette.styles(labels[::-1])
    assert list(palette.styles(labels)) == labels
