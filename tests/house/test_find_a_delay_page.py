"""The page on a sensor's delay prints what its commands find."""

import re
from pathlib import Path

import pytest

import pcbench

PAGE = (Path(pcbench.__file__).parent / "guide" / "find_a_delay.md").read_text()


@pytest.mark.ci
def test_numbers_of_the_page_are_those_of_its_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("platform.toml").write_text(re.search(r'```toml title="platform.toml"\n(.*?)```', PAGE, re.S)[1])
    pcbench.simulate("platform.toml", "kf", log="camera", overrides=["axes.timestamp_offset=[0.08]"])
    found = pcbench.tune("platform.toml", "kf", log="camera", find_delay=True, out="tuned")
    (one,) = found.delays
    assert f"y1          {one.estimate:.4g}   {one.low:.4g} to {one.high:.4g}   -0.02 to 0.4" in PAGE
    assert f'"y1": {{"estimate": {one.estimate:.4f}, "low": {one.low:.4f}, "high": {one.high:.4f}}}' in PAGE
    axis = "axes.assumed_delay_error=[0.0, 0.04, 0.08, 0.12]"
    for row in pcbench.replay("camera", "tuned/tuned.toml", "kf", overrides=[axis]).innovations.to_dict("records"):
        values = f"{row['assumed_delay_error']} | {row['nis']:.2f} | {row['log_likelihood']:.2f}"
        assert f"| {values} |" in PAGE
