"""The options that all laws have, and the types of theirs."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

from pcbench.controllers.parts.set_points import SetPoints

Number = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
Rows = list[list[Number]]
Weight = Number | list[Number] | Rows  # one for all, a diagonal, or a matrix
COST = "weight of the metric `lq_cost`; default: there is none"


class Options(BaseModel):
    """What all laws have."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    period: Positive | None = Field(
        None, description="between decisions [s], the command held between; default: one tick"
    )
    limit: Positive | list[Positive] | None = Field(
        None, description="largest command, one or one for each input; default: none"
    )
    offset: Number | list[Number] = Field(0.0, description="[m] added to every command: the operating point's input")
    set_point: SetPoints = Field({}, description="by state: a number, or a table with step, sine or table; default: 0")
    Q1: Weight | None = Field(None, description=COST)
    Q2: Weight | None = Field(None, description=COST)
