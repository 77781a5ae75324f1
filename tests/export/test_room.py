"""What an exported observer does with a measurement outside its room: `jump` returns 1 and changes nothing."""

import re
import subprocess

import exports
import numpy as np
import pytest
from logged import MOTOR, rows

from pcbench.export import files

DRIVER = """#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "{label}.h"
#include "{label}_gains.h"
/* A measurement every {every} ticks, {late} ticks late; at tick {at} one more of an age that is given: what comes of it. */
int main(int argc, char **argv)
{{
    static {label}_memory m, old;
    static {label}_now now;
    static {label}_real notes[{ticks}][8];
    {label}_real x0[8] = {{0}}, u[8] = {{1}}, xhat[8];
    int refused = 0, code = -1, same = -1;
    {label}_begin(&now);
    {label}_init(&{label}_nominal, x0, &m);
    for (int64_t k = 0; k < {ticks}; k++) {{
        {note}
        int64_t ages[2] = {{{late}, strtoll(argv[1], NULL, 10)}};
        for (int i = 0; i < 2; i++) {{
            if (i == 0 ? k < {late} || (k - {late}) % {every} : k != {at}) continue;
            {label}_arrival a = {{.value = {{0.3}}, .mask = {{true}}, .age = {{ages[i]}}}};
            int64_t taken = ages[i] >= 0 && ages[i] <= k ? k - ages[i] : 0;
            {carry}
            memcpy(&old, &m, sizeof m);
            int answer = {label}_jump(&{label}_nominal, &m, &now, &a);
            if (i) code = answer, same = !memcmp(&old, &m, sizeof m); else refused += answer;
        }}
        {label}_estimate(&{label}_nominal, &m, xhat);
        {label}_hold(&now, u);
        {label}_flow(&{label}_nominal, &m, &now);
        {label}_next(&now);
    }}
    printf("%d %d %d %.17g\\n", refused, code, same, (double)xhat[0]);
    return argc < 0;
}}
"""


def driven(found, folder, every, late, at, ticks, age):
    """(measurements refused in order, answer to the one of `age`, whether it left the memory alone, the last estimate)."""
    if files.compiler() is None:
        pytest.skip("there is no C compiler here: install one, for this to be tested")
    label = found.about.label
    if not (folder / "driver").exists():
        files.write(found, folder)
        noted = f"{label}_snapshot(" in found.files[f"{label}.h"]
        note = f"{label}_snapshot(&{label}_nominal, &m, &now, notes[k]);" if noted else "(void)notes;"
        carry = "memcpy(a.snapshot, notes[taken], sizeof a.snapshot);" if noted else "(void)taken;"
        text = DRIVER.format(label=label, every=every, late=late, at=at, ticks=ticks, note=note, carry=carry)
        (folder / "driver.c").write_text(text)
        line = [files.compiler(), "-std=c99", "-O1", "driver.c", f"{label}.c", "-lm", "-o", "driver"]
        subprocess.run(line, cwd=folder, check=True)
    ran = subprocess.run([folder / "driver", str(age)], capture_output=True, text=True, check=True, timeout=60)
    return [float(x) for x in ran.stdout.split()]


@pytest.mark.ci
@pytest.mark.parametrize(
    "name", ["kf", *(pytest.param(each, marks=pytest.mark.nightly) for each in ("ekf", "kf-reprocess", "mhe"))]
)
def test_jump_refuses_measurement_older_than_room_and_changes_nothing(name, tmp_path):
    """Before, one such measurement made every estimate NaN for good (the servo that was asked about, 0.3 s)."""
    plant = MOTOR | {"name": "fast", "lti": MOTOR["lti"] | {"delay": 0.05, "sampling_period": 0.05, "duration": 3.0}}
    found = files.export_observer(plant, name)
    oldest = found.about.oldest
    assert re.search(rf"_OLDEST_AGE {oldest} /\* ticks \*/", found.files[f"{found.about.label}.h"])
    assert f"_MAX_NEWER {found.about.newer} /* newer measurements */" in found.files[f"{found.about.label}.h"]
    assert 5 <= oldest < 100, "the ages that follow are about this room"
    run = {"every": 5, "late": 5, "at": 152, "ticks": 700}  # longer than the horizon
    usual = driven(found, tmp_path, **run, age=-1)
    assert usual[:3] == [0, 1, 1]
    assert np.isfinite(usual[3])
    for age in (oldest + 1, 153, -(2**63), -(2**63) + 1, 2**63 - 1, 2**62, 2**31, -(2**31)):
        assert driven(found, tmp_path, **run, age=age) == usual, age
    for age in (3, 5, 7):  # taken after the newest that was used, or with it
        used = driven(found, tmp_path, **run, age=age)
        assert used[:2] == [0, int(age > oldest)], age
        assert np.isfinite(used[3])


@pytest.mark.ci
def test_jump_uses_measurement_of_oldest_admissible_age(tmp_path):
    """Measurements so old that they are in order at the age that the header names."""
    found = files.export_observer(MOTOR, "kf")
    oldest = found.about.oldest
    assert driven(found, tmp_path, every=oldest + 1, late=oldest, at=2 * oldest, ticks=3 * oldest + 2, age=oldest)[
        :2
    ] == [0, 0]


@pytest.mark.ci
def test_jump_refuses_measurement_that_more_newer_ones_overtook(tmp_path):
    """No sample overtakes another on this schedule, so there is no room: what was garbage is refused."""
    plant = MOTOR | {"lti": MOTOR["lti"] | {"delay": 0.0}}
    found = files.export_observer(plant, "kf")
    refused, code, same, xhat = driven(found, tmp_path, every=2, late=0, at=50, ticks=99, age=3)
    assert (refused, code, same) == (0, 1, 1)
    assert np.isfinite(xhat)


@pytest.mark.ci
def test_jump_uses_measurement_after_as_many_newer_ones_as_the_header_names(tmp_path):
    """A measurement comes every 2 ticks, without delay; one of age 2 N - 1 arrives after N newer ones."""
    found = files.export_observer(MOTOR | {"lti": MOTOR["lti"] | {"delay": 0.0, "delay_jitter": 0.2}}, "kf")
    newer = found.about.newer
    assert newer > 1
    for age, code in ((2 * newer - 1, 0), (2 * newer + 1, 1)):
        assert age <= found.about.oldest
        assert driven(found, tmp_path, every=2, late=0, at=50, ticks=99, age=age)[1] == code


def _recording(folder):
    """Delays of 20 to 400 ms on a plant that expects 100: samples overtake each other, and one is 0.7 s late; a gap of 1 s."""
    random = np.random.default_rng(3)
    t = np.arange(60) * 0.05
    t[40:] += 1.0
    late = 0.01 * random.integers(2, 40, 60)
    late[20] = 0.7
    columns = {
        "channel": ["y1"] * 60,
        "sampled": t,
        "arrived": t + late,
        "value": np.sin(t) + 0.1 * random.normal(size=60),
    }
    return rows(folder, columns, {"t": np.arange(450) * 0.01, "u1": np.sin(np.arange(450) * 0.05)})


@pytest.mark.parametrize(
    "name", ["kf", *(pytest.param(each, marks=pytest.mark.nightly) for each in ("ekf", "pccebo", "kf-cloning", "mhe"))]
)
def test_c_of_recording_equals_its_replay(name, tmp_path):
    log = _recording(tmp_path / "flight")
    found = files.export_observer(MOTOR, name, log=log)
    assert exports.off(found, exports.program_output(found)) < 1e-12
    assert "unknown" not in found.files["main.c"]
    assert found.about.oldest >= 70


@pytest.mark.ci
def test_c_without_room_for_recording_is_not_silent(tmp_path):
    """The C of the plant file alone, run on the recording: it says how many measurements it refused, and is finite."""
    log = _recording(tmp_path / "flight")
    narrow, wide = files.export_observer(MOTOR, "kf"), files.export_observer(MOTOR, "kf", log=log)
    mixed = narrow._replace(files=narrow.files | {"vector.h": wide.files["vector.h"]})
    with pytest.raises(files.UserError, match=r"\d+ measurements are older than the room of kf"):
        exports.program_output(mixed)
