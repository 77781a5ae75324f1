"""Fair tuning: every observer gets the same effort on the same training runs, and is judged on others."""
