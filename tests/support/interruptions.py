"""A tuning that is stopped by Ctrl-C in the middle."""

from pcbench.gains import objective_eval


def stop_tuning_at(number, monkeypatch):
    """Raise KeyboardInterrupt when a tuning evaluates its `number`-th point; return the list that counts evaluations."""
    real, count = objective_eval.evaluator, [0]

    def interrupted(*given):
        evaluate = real(*given)

        def at(point):
            count[0] += 1
            if count[0] == number:
                raise KeyboardInterrupt
            return evaluate(point)

        return at

    monkeypatch.setattr(objective_eval, "evaluator", interrupted)
    monkeypatch.setattr("pcbench.gains.history.PAUSE", 0.0)
    return count
