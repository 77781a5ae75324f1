"""Terminal output: progress, tables of results, gains, folders, claims and lists."""
