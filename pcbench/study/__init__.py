"""A study: scenarios x observers x axes x seeds, with the options of each observer.

Every error is one sentence: the place, the value, what was expected, and how to correct it.
"""

from pcbench.study.builtin import STUDIES
from pcbench.study.labels import LTI, labels_of, observers_of, scenarios_of, title_of_scenario
from pcbench.study.options import (
    checked_options,
    choices_of,
    merge_options,
    options_of,
    to_underscores,
    underscore_keys,
)
from pcbench.study.schema import KEYS, TUNINGS, Choices, Study, Tune, TunedCell, TunedOptions, Values

__all__ = [
    "KEYS",
    "LTI",
    "STUDIES",
    "TUNINGS",
    "Choices",
    "Study",
    "Tune",
    "TunedCell",
    "TunedOptions",
    "Values",
    "checked_options",
    "choices_of",
    "labels_of",
    "merge_options",
    "observers_of",
    "options_of",
    "scenarios_of",
    "title_of_scenario",
    "to_underscores",
    "underscore_keys",
]
