"""Gains tuned on runs and compared at equal effort. Gains by LMI and by Riccati equation are computed in `pcbench.synthesis`.

- `design`: one observer's gain and its certificate, as the command `design` shows it
- `tune`, `parameters`, `optimizers`, `objective`, `objective_eval`, `validation`, `history`: tuning of options
- `gain_variants`, `fair_comparison`: comparison of published, designed and tuned gains
"""
