"""Studies as datasets: from missing blocks to tasks, from tasks to whole files, from files to closing tables.

`storage` (whole files), `parquet_io` (tables with their digest), `seed_ranges` (their ranges), `block_files` (blocks on disk),
`manifest` (whose they are), `serialize` (planned cells as bytes), `task` (some blocks computed), `executors` (where tasks are
done), `run_missing` (the blocks that are missing), `aggregate` and `close` (stats and pairs), `adaptive_seeds` (more seeds),
`verify` (status, blocks computed again), `merge`, `compare`, `run_study` (all of it) and `result`.
"""
