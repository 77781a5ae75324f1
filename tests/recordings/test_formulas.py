"""A formula of fields comes to what NumPy, SciPy and the coordinates of the earth make of it, in parts as in one piece."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pcbench.errors import UserError
from pcbench.recordings import readers
from pcbench.recordings.formulas import quantity

RNG = np.random.default_rng(3)
T = np.arange(200) * 0.05


def compute(formula, parts=1, **fields):
    """A formula of fields that come in some parts."""
    evaluate = quantity(None, formula, 1.0, 0.0, "log").evaluator()
    split = {name: np.array_split(np.asarray(values, float), parts) for name, values in fields.items()}
    return np.concatenate([evaluate({name: each[i] for name, each in split.items()}) for i in range(parts)])


def test_formula_is_the_same_as_in_numpy():
    a, b = RNG.normal(size=(2, 50))
    found = compute("-2*a^2 + sin(pi*b)/(1 + exp(a)) - atan2(a, b - 0.5) + sqrt(abs(a))", a=a, b=b)
    want = -2 * a**2 + np.sin(np.pi * b) / (1 + np.exp(a)) - np.arctan2(a, b - 0.5) + np.sqrt(np.abs(a))
    np.testing.assert_allclose(found, want, rtol=1e-14)


def test_yaw_is_that_of_the_rotation():
    rotation = Rotation.random(100, rng=RNG)
    x, y, z, w = rotation.as_quat().T
    want = rotation.as_euler("ZYX")[:, 0]
    np.testing.assert_allclose(compute("yaw(w, x, y, z)", w=w, x=x, y=y, z=z), want, rtol=0, atol=1e-12)
    pose = {f"pose.q.{name}": each for name, each in zip("xyzw", (x, y, z, w), strict=True)}
    np.testing.assert_allclose(compute("yaw(pose.q)", **pose), want, rtol=0, atol=1e-12)


def earth(lat, lon):
    """Earth-centred coordinates of points on the ellipsoid of WGS84 [m], by its axes."""
    a, b = 6378137.0, 6356752.314245
    lat, lon = np.radians(lat), np.radians(lon)
    n = a**2 / np.sqrt((a * np.cos(lat)) ** 2 + (b * np.sin(lat)) ** 2)
    return np.stack([n * np.cos(lat) * np.cos(lon), n * np.cos(lat) * np.sin(lon), (b / a) ** 2 * n * np.sin(lat)], -1)


@pytest.mark.parametrize(("lat0", "lon0"), [(48.1, 11.6), (-33.0, 179.9995)])
def test_north_and_east_are_metres_on_the_ground(lat0, lon0):
    lat, lon = lat0 + RNG.uniform(-1e-3, 1e-3, 50), lon0 + RNG.uniform(-1e-3, 1e-3, 50)
    away = earth(lat, lon) - earth(lat0, lon0)
    phi, lam = np.radians([lat0, lon0])
    east = away @ [-np.sin(lam), np.cos(lam), 0.0]
    north = away @ [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)]
    wrapped = (lon + 180) % 360 - 180  # a receiver gives -180 to 180 degrees
    np.testing.assert_allclose(compute(f"north(lat, {lat0})", lat=lat), north, atol=5e-3)
    np.testing.assert_allclose(compute(f"east(lon, {lat0}, {lon0})", lon=wrapped), east, atol=5e-3)


@pytest.mark.parametrize("parts", [1, 3, 200])
def test_unwrap_and_diff_go_on_from_part_to_part(parts):
    angle = 20 * np.sin(T)
    wrapped = np.angle(np.exp(1j * angle))
    gaps = wrapped.copy()
    gaps[7::11] = np.nan
    np.testing.assert_allclose(compute("unwrap(x)", parts, x=wrapped), angle, atol=1e-12)
    np.testing.assert_allclose(compute("unwrap(x, 360)", parts, x=np.degrees(wrapped)), np.degrees(angle), atol=1e-10)
    found = compute("unwrap(x)", parts, x=gaps)
    np.testing.assert_allclose(found[~np.isnan(gaps)], angle[~np.isnan(gaps)], atol=1e-12)
    assert np.isnan(found[7::11]).all()
    steps = compute("diff(x) - diff(2*x)/2 + diff(x)", parts, x=angle)
    assert np.isnan(steps[0])
    np.testing.assert_allclose(steps[1:], np.diff(angle), atol=1e-12)


def test_channels_inputs_and_truth_may_be_formulas(tmp_path):
    table = {"t": T, "Temp °C": 20 + T, "a": np.sin(T), "b": np.cos(T)}
    pd.DataFrame(table).to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "log.toml").write_text(
        'log = "run.csv"\n[channels.y1]\nformula = "\'Temp °C\' + 273.15"\nscale = 2.0\nunit = "K"\ndelay = 0.0\n'
        '[inputs.u1]\nformula = "a - b"\nunit = "V"\n[truth.x]\nformula = "a^2"\nunit = "m"\n'
    )
    log = readers.open_log(tmp_path / "log.toml")
    (batch,), (inputs,), (truth,) = log.measurements(), log.inputs.read(), log.truth.read()
    np.testing.assert_allclose(batch.value, 2 * (T + 293.15), rtol=1e-15)
    np.testing.assert_allclose(inputs.values[:, 0], np.sin(T) - np.cos(T), rtol=1e-15)
    np.testing.assert_allclose(truth.values[:, 0], np.sin(T) ** 2, rtol=1e-15)


@pytest.mark.parametrize(
    ("formula", "sentence"),
    [
        ("__import__('os')", "expected one of the functions"),
        ("eval(a)", "expected one of the functions abs, atan2"),
        ("a.__class__", "got double, which has no '__class__'"),
        ("open('/etc/passwd')", "expected one of the functions"),
        ("a[0]", "expected a formula of numbers, names, + - * / ^, functions and parentheses (not '[')"),
        ("sin(a, a)", "expected 1 arguments of sin, not 2"),
        ("sin(a", "expected a formula whose parentheses are closed"),
        ("(" * 200 + "a" + ")" * 200, "expected a formula of at most 1000 characters, 100 words and signs"),
        ("1 + 2", "expected a formula of one field at least"),
        ("a + z", "'z' is no column here"),
        ("", "expected a formula that goes on"),
        ("1/(a - a)", "row 1 of channel y1: got the value inf"),
    ],
)
def test_what_is_no_formula_is_one_sentence(tmp_path, formula, sentence):
    pd.DataFrame({"t": T, "a": 1.0}).to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "log.toml").write_text(
        f'log = "run.csv"\n[channels.y1]\nformula = "{formula}"\nunit = "m"\ndelay = 0.0\n'
    )
    from pcbench.recordings.survey import survey

    with pytest.raises(UserError) as caught:
        survey(readers.open_log(tmp_path / "log.toml"))
    assert sentence in str(caught.value)
