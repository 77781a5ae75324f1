"""The types of options that laws share."""

from typing import Annotated

from pydantic import Field, Strict

from pcbench.controllers.parts.set_points import SetPoints

Number = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
Rows = list[list[Number]]
Weight = Number | list[Number] | Rows  # one for all, a diagonal, or a matrix
Period = Annotated[
    Positive | None, Field(description="between decisions [s], the command held between; default: one tick")
]
Limit = Annotated[
    Positive | list[Positive] | None, Field(description="largest command, one or one for each input; default: none")
]
Offset = Annotated[Number | list[Number], Field(description="[m] added to every command: the operating point's input")]
Aims = Annotated[SetPoints, Field(description="by state: a number, or a table with step, sine or table; default: 0")]
Cost = Annotated[Weight | None, Field(description="weight of the metric `cost`; default: there is none")]
