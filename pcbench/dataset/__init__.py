"""Datasets: from a study's missing blocks to tasks, to complete files, and to the closing tables.

`task.compute` writes a block's Parquet file through `storage.write_table`.

`storage` (files), `parquet_io` (tables with their digest), `seed_ranges` (ranges of seeds), `block_files` (blocks on
disk), `manifest` (the study of a folder), `serialize` (planned cells as bytes), `task` (computation of some blocks),
`executors` (where tasks run), `run_missing` (computation of the missing blocks), `moments_tables` (exact numbers),
`aggregate` and `close` (stats, pairs), `adaptive_seeds` (more seeds), `verify` (status, recomputed blocks), `merge`,
`compare`, `run_study` (all steps) and `result`. Not about datasets: `single_table` (one table as a file).
"""
