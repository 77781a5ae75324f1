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
    "Nesic, Teel 2004; Carnevale, Teel, Nesic 2007": (
        "text of the papers",
        "their bounds on the interval, from memory",
    ),
    "Sinopoli et al. 2004": ("numbers of the examples", "the theorem's bounds for three plants"),
    "Schenato 2008": ("text of the theorem on a finite buffer", "arrival rates of three buffers"),
    "Raff, Koegel, Allgoewer 2008": ("interval, gain, initial states, noise", "an interval that is certified here"),
    "Etienne, Hetel, Efimov, Petreczky 2017": ("interval and gain", "an interval that is certified here"),
    "Petri et al., arXiv 2210.03368": (
        "intervals and settings of the case study",
        "an interval that is certified here",
    ),
    "Raghavan, Hedrick 1994": ("text of the paper", "constants seen in public programs"),
    "Fridman 2010": ("text of the paper", "its functional from memory, checked along runs with random intervals"),
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
    "Gopalakrishnan, Kaisare, Narasimhan 2011": ("equations, parameters, tables", "its comparison on the digester"),
    "Hellmann et al., arXiv 2512.20354": ("model, delays, tables", "an earlier program of the first author"),
    "Xiao, Chen 2020": ("text of the paper, period and latency of its camera, target model", "numbers of our own"),
    "Natori, Oboe, Ohnishi 2008": ("text of the paper", "the structure from memory, and its computed limit"),
    "Ferrante, Seuret, arXiv 2102.10652": ("matrices and intervals of the example", "an inequality of this project"),
    "Sferlazza, Tarbouriech, Zaccarian 2019": (
        "matrices and intervals of the example",
        "an inequality of this project",
    ),
    "Germani, Manes, Pepe 2002": ("text of the paper", "the structure from memory, and its computed limits"),
    "Ahmed-Ali, Cherrier, Lamnabhi-Lagarrigue 2012": ("text of the paper", "the same structure, on the flexible joint"),
    "Karafyllis, Kravaris 2009": ("text of the paper", "the structure from memory, and its computed limits"),
    "Nadri, Hammouri, Mota 2013; Farza et al. 2014, 2015": ("text of the papers", ""),
    "Gao 2003; Miklosovic, Radke, Gao 2006": (
        "text of the papers",
        "gains seen in Joiner12/MatlabFiles; the discrete form from memory, with its poles checked",
    ),
    "Davila, Fridman, Levant 2005": (
        "text of the paper",
        "gains and pendulum seen in a public program; the implicit step is of this project",
    ),
    "Engel, Kreisselmeier 2002": ("text of the paper", "its equations from memory, checked by an error of zero"),
    "Mazenc, Dinh 2014": ("text of the paper", "a scheme of this project whose coverage is 1"),
    "Astrom, Bernhardsson 2002": ("text of the paper", "equations of exit times, solved here"),
    "Nguyen, Suh 2008": ("an earlier paper on their filter", "its description by Nguyen and Suh"),
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
