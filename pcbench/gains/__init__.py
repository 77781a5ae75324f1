"""The gains of a study: by design, by tuning, and compared fairly."""
