"""What a study's table `[scenario]` may say: every field of a scenario, spelled flat, or `base` with some of them changed."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict

from pcbench.errors import printable
from pcbench.study import axes

Degrees = Annotated[float, Strict(), Field(allow_inf_nan=True)]  # inf: without an end
Number = Annotated[float, Strict(), Field(ge=-axes.LARGEST, le=axes.LARGEST)]  # Strict: no text, no true or false
Positive = Annotated[Number, Field(ge=axes.SMALLEST)]
Size = Annotated[Number, Field(ge=0)]
Switch = Annotated[bool, Strict()]
PerChannel = Number | list[Number]
Words = Annotated[str, AfterValidator(printable)]


class ScenarioTable(BaseModel):
    """A scenario of a user's own. n states, s unknowns beside them, q outputs; what is left out is the base's, or a default.

    One number in place of a list holds for all of them.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    base: str | None = Field(None, description="a published scenario, of which the other keys change fields")
    name: str | None = Field(
        None, pattern=r"^\w[\w./+-]*$", max_length=100, description="what tables call it; default: the study's name"
    )
    summary: Words | None = Field(None, description="in a few words")
    source: Words | None = Field(None, description="paper and section")
    plant: str | None = Field(None, description="pcbench list plants")
    observers: list[str] | None = Field(None, min_length=1, description="those that run unless a study names others")
    dt: Positive | None = Field(None, description="s, the tick; default 0.001")
    duration: Positive | None = Field(None, description="s; default 10")
    # what is true of the plant and told to no observer
    x0: Number | list[Number] | None = Field(None, description="[n] x(0)")
    parameter_drift: Number | None = Field(None, description="scale of the plant's parameter drift")
    parameters: dict[str, Any] | None = Field(None, description="the plant's, where they differ from its own")
    process_std: Size | list[Size] | None = Field(
        None, description="[n] of the noise added to each state at every tick"
    )
    unknown_input: Any | None = Field(None, description="of what pushes: as `input` says it")
    # what drives the plant
    input: Any | None = Field(
        None,
        description="a signal's name, or one for each input, with commas; or a wave, values, rows, a CSV file; default: sine",
    )
    controller: str | None = Field(None, description="what gives the commands of a closed loop; empty: it is open")
    control: dict[str, Any] | None = Field(None, description="the controller's options")
    actuator_delay: Size | None = Field(None, description="s, from command to plant; left out: the measurements'")
    command_jitter: Size | None = Field(None, description="s, a command comes up to this much later")
    command_loss: Annotated[Size, Field(le=1)] | None = Field(
        None, description="probability that a command never comes"
    )
    command_std: Size | None = Field(None, description="of the noise of one command")
    # how it is measured
    sampling_period: PerChannel | None = Field(None, description="[q] s, one or one for each output")
    delay: PerChannel | str | None = Field(None, description="[q] s, one or one for each output, or 'interval'")
    noise_std: PerChannel | None = Field(None, description="[q] of one sample, one or one for each output")
    sampling_pattern: str | list[Number] | None = Field(None, description="of the intervals: a name, or s in turn")
    sampling_jitter: Number | None = Field(None, description="s, a sample is taken up to this much early or late")
    delay_jitter: Number | None = Field(None, description="s, a sample arrives up to this much later")
    delay_values: list[Number] | None = Field(
        None, description="s, a sample arrives later by one of them, a Markov chain from sample to sample"
    )
    delay_self_transition: PerChannel | None = Field(
        None, description="probability that the next sample has the same step, one or one for each"
    )
    delay_sequence: list[Number | Literal["lost"]] | None = Field(
        None, description="s, samples arrive later by these in turn, the same in all runs; 'lost': that one never does"
    )
    loss: Number | None = Field(None, description="probability that a sample never arrives")
    delay_weights: list[Number] | None = Field(
        None, description="of samples, each by itself, that are later by each step, in proportion; no chain then"
    )
    delay_gamma_mean: Number | None = Field(
        None, description="s, mean of a gamma distribution by which a sample is later"
    )
    delay_gamma_shape: Number | None = Field(None, description="of that distribution; 1: it is exponential")
    mean_burst_length: Number | None = Field(
        None, description="mean number of samples in a row that losses take; 0: one by one"
    )
    quantization_step: PerChannel | None = Field(
        None, description="[q] a sample is rounded to whole steps of this size"
    )
    dither: Number | None = Field(None, description="1: noise over one step is added before rounding, taken off after")
    timestamp_offset: Number | None = Field(None, description="s, stamps say that samples were taken so much later")
    clock_skew: Number | None = Field(None, description="ppm, by which the clock of the stamps is fast")
    timestamp_jitter: Number | None = Field(None, description="s, a stamp is wrong by up to this much, either way")
    outlier_probability: Number | None = Field(
        None, description="that a sample's noise is outlier_scale times what it would be"
    )
    outlier_scale: Number | None = Field(None, description="how many times larger the noise of an outlier is")
    student_t_dof: Degrees | None = Field(
        None,
        description="degrees of freedom of Student's t that the noise has, of the same variance; inf: it is Gaussian",
    )
    prefilled: Switch | None = Field(None, description="measuring began before t = 0: the first sample arrives at 0")
    delay_sine: list[Number] | None = Field(
        None, min_length=2, max_length=2, description="(a [s], w [rad/s]): every delay is delay + a sin(w t)"
    )
    continuous: Switch | None = Field(None, description="measured at every stage of the integration, without noise")
    # what designers and observers assume
    xhat0: Number | list[Number] | None = Field(None, description="[n] xhat(0); default: zeros")
    prior_std: Size | list[Size] | None = Field(
        None, description="[n] of x(0) about xhat(0); default: |x0 - xhat0|, or 1"
    )
    model: dict[str, Any] | None = Field(None, description="the plant's parameters as observers know them")
    drift_intensity: Size | None = Field(None, description="1/s, process noise through the input where it drifts")
    unknown0: Number | list[Number] | None = Field(
        None, description="[s] what observers take for the unknowns at the start"
    )
    unknown_std: Positive | list[Positive] | None = Field(
        None, description="[s] typical size of the unknowns; default: ones"
    )
    assumed_noise_std: Size | list[Size] | None = Field(None, description="[q] for channels without noise")
    assumed_process_std: Size | list[Size] | None = Field(None, description="[n] for plants without process noise")
    assumed_noise_scale: Number | None = Field(
        None, description="the noise of a sample is believed to be so many times larger than it is"
    )
    assumed_delay_error: Number | None = Field(None, description="s, samples are believed to be so much older")
    initial_box: Size | list[Size] | None = Field(
        None, description="[n] a random start draws xhat(0) this close to x(0)"
    )
    # what runs are judged by
    settle_band: Size | list[Size] | None = Field(
        None, description="[n + s] |e| of a settled run; default: 5 % of the prior"
    )
    divergence_threshold: Positive | list[Positive] | None = Field(
        None, description="a run has diverged when an |e| leaves it"
    )
    steady_start: Size | None = Field(None, description="s, where the tail starts; default: 30 % of the horizon")
    signals: list[str] | None = Field(None, description='[n] names of states with units, such as "angle [rad]"')
    unknowns: list[str] | None = Field(None, description="[s] names of unknowns with units")
    headline: list[str] | None = Field(None, description="signals that a closing table shows")
    options: dict[str, dict[str, Any]] | None = Field(None, description="of observers, by label")

    def given(self) -> dict[str, Any]:
        """Return what the table says of the scenario's fields."""
        said = {key: getattr(self, key) for key in type(self).model_fields if key not in ("base", "name")}
        return {key: value for key, value in said.items() if value is not None}
