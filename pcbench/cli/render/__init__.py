"""What a person reads in the terminal: progress, tables of results, gains, folders, claims, what there is."""
