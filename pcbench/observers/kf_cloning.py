"""kf-cloning: stochastic cloning, a Kalman filter whose state has copies of itself at the ticks at which samples were taken.

K = h / s of the whole state (`parts/stochastic_cloning`): the present and every copy are corrected by each sample, through the
copy of its time.

Source: Roumeliotis, Burdick 2002 (stochastic cloning, there for relative measurements); on late measurements the
augmented state of many. Keeps J + 1 states and their joint covariance, J the samples that can be on their way at once;
costs an update of all.
Found: it is `kf` to rounding whatever is late, lost or overtaking, as said (arXiv 2508.21260); `kf` gets there with n
states. It must be told when a sample is taken, and of a lost one keeps the copy until it is overwritten.
Time index: the estimate is of now, after the jump.
"""

from pcbench.observers.parts import linear_filter, stochastic_cloning
from pcbench.synthesis.certificate import Design, DesignContext

Options = linear_filter.Options
OBSERVER = stochastic_cloning.observer(lambda h, s, near: h / s)._replace(innovation=stochastic_cloning.innovation)


def design(setting: DesignContext, options: Options) -> Design:
    """Gather what the filter assumes, with room for the copies."""
    return linear_filter.design(setting, options, "kf-cloning", own=stochastic_cloning.room(setting, "kf-cloning"))
