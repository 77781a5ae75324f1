"""Sources and printed numbers that could not be read, so that no claim rests on them.

A number that is only remembered is no evidence, so it has no verdict.
"""

from pcbench.papers.claim import NOT_OBTAINED, Claim

MISSING = {  # by source: what is missing, and what the table has instead
    "Walsh, Ye 2001": ("text of the paper", "matrices seen in IMPACT4Mech/continuous-time_data-driven_control"),
    "Heemels, Teel, van de Wouw, Nesic 2010": (
        "bounds on the interval, pairs of interval and delay, noise, initial states",
        "L and gamma, from which the bounds follow",
    ),
    "Sinopoli et al. 2004": ("numbers of the examples", "the theorem's bounds for three plants"),
    "Schenato 2008": ("text of the theorem on a finite buffer", "arrival rates of three buffers"),
    "Raff, Koegel, Allgoewer 2008": ("interval, gain, initial states, noise", "eigenvalues of the flexible joint"),
    "Etienne, Hetel, Efimov, Petreczky 2017": ("interval and gain", "eigenvalues of the flexible joint"),
    "Petri et al., arXiv 2210.03368": ("intervals and settings of the case study", ""),
    "Raghavan, Hedrick 1994": ("text of the paper", "constants seen in public programs"),
    "Johansson 2000": (
        "text of the paper, printed zeros and relative gains",
        "constants seen in public programs, all else computed",
    ),
    "Gordon, Salmond, Smith 1993": ("text of the paper", "one sentence on coverage, seen in a reading note"),
    "Arulampalam et al. 2002": ("printed table of errors", "errors of an independent program"),
    "Zhang, Branicky, Phillips 2001": (
        "text of the paper, and the bounds of later papers for variable periods",
        "gain seen in AntonSelivanov/CDC16a; the largest constant period",
    ),
    "Arasaratnam, Haykin 2009": ("initial covariance, and curves of the errors", "a covariance from memory"),
    "Julier, Uhlmann, Durrant-Whyte 2000": (
        "text of the paper, curves of the errors",
        "constants seen in wengjn/MatlabDBN, errors of an independent program",
    ),
    "Gopalakrishnan, Kaisare, Narasimhan 2011": ("equations, parameters, tables", ""),
    "Hellmann et al., arXiv 2512.20354": ("model, delays, tables", "an earlier program of the first author"),
    "Xiao, Chen 2020": ("text of the paper, period and latency of its camera, target model", "numbers of our own"),
    "Natori, Oboe, Ohnishi 2008": ("text of the paper", "the structure from memory, and its computed limit"),
    "Ferrante, Seuret, arXiv 2102.10652": ("matrices and intervals of the example", ""),
    "Sferlazza, Tarbouriech, Zaccarian 2019": ("matrices and intervals of the example", ""),
    "Karafyllis, Kravaris 2009": ("text of the paper", ""),
    "Ahmed-Ali, Cherrier, Lamnabhi-Lagarrigue 2012": ("text of the paper", ""),
    "Mazenc, Dinh 2014": ("text of the paper", ""),
    "Signal Processing 114 (2015) 75": ("the paper", ""),
    "arXiv 2108.04591": ("the paper", ""),
    "Revach et al., arXiv 2107.10043": ("tables of the errors", ""),
    "Mortada et al., arXiv 2506.11639": ("tables of the errors", ""),
}


def rows() -> list[Claim]:
    """Return one row for each source of which something could not be read."""
    return [
        Claim(missing, NOT_OBTAINED, instead or "nothing", NOT_OBTAINED, source=source)
        for source, (missing, instead) in MISSING.items()
    ]
