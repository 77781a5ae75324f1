"""Studies as datasets: from missing blocks to tasks, from tasks to whole files, from files to closing tables.

`store` (whole files), `parquet` (tables with their digest), `seeds` (their ranges), `block_files` (blocks on disk), `ownership`
(whose they are), `pickled` (planned cells as bytes), `task` (some blocks computed), `executors` (where tasks are done), `fill`
(the blocks that are missing), `cell_rows` and `summary` (stats and pairs), `precision` (more seeds), `verify` (status, blocks
computed again), `merge`, `compare`, `repair`, `run_study` (all of it) and `result`.
"""
