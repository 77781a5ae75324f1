"""Studies as datasets: from missing blocks to tasks, from tasks to whole files, from files to closing tables.

A block's Parquet file is written by `task.compute`, by way of `storage.put_table`.

`storage` (whole files), `parquet_io` (tables with their digest), `seed_ranges` (their ranges), `block_files` (blocks on disk),
`manifest` (whose they are), `serialize` (planned cells as bytes), `task` (some blocks computed), `executors` (where tasks are
done), `run_missing` (the blocks that are missing), `moments_tables` (exact numbers), `aggregate` and `close` (stats, pairs),
`adaptive_seeds` (more seeds), `verify` (status, blocks computed again), `merge`, `compare`, `run_study` (all) and `result`.
Other than datasets: `single_table` (a table that a user asks for as one file).
"""
