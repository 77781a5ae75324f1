"""Flight logs of PX4 (ULog), read by pyulog. Stamps are microseconds since start; a topic's instance n is "topic.n".

A ULog is read as a whole: its reader has no other way.
"""

from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

from pcbench.errors import UserError, said, unknown
from pcbench.logs.log import Floats
from pcbench.logs.messages import require_topic

MICROSECOND = 1e-6


def fields(
    path: Path, topic: str, wanted: list[str], times: set[str], unit: str | None, where: str
) -> Iterator[dict[str, Floats]]:
    """Yield a topic's fields, [K] each; stamps in seconds. A message that has no stamp_sample is stamped when it was logged."""
    from pyulog import ULog

    try:
        with redirect_stdout(StringIO()) as remarks:  # how its reader says what it has passed over
            log = ULog(str(path))
    except Exception as error:  # pyulog raises TypeError and struct.error among others
        raise UserError(f"{where}: {path.name}: {said(error)}; expected a whole ULog; mend it.") from None
    if log.file_corruption or "corrupt" in remarks.getvalue():
        raise UserError(
            f"{where}: {path.name}: got records that cannot be read among others, expected a whole ULog; mend it."
        )
    name, _, instance = topic.partition(".")
    every = {f"{d.name}.{d.multi_id}" if d.multi_id else d.name: d for d in log.data_list}
    asked = f"{name}.{instance}" if instance not in ("", "0") else name
    require_topic(asked, every, where)
    data = every[asked].data
    out = {}
    for field in wanted:
        place = "timestamp" if field == "timestamp_sample" and field not in data else field
        if place not in data:
            raise unknown(f"{where}: {topic}", "field", field, data)
        out[field] = np.asarray(data[place], float) * (MICROSECOND if field in times else 1.0)
    yield out
