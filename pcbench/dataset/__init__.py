"""Studies as datasets: from missing blocks to tasks, from tasks to whole files, from files to closing tables.

`store` (whole files), `ledger` (blocks on disk), `folder` (whose they are), `parcel` (planned cells as bytes), `blocks` (one
task), `executors` (where tasks are done), `campaign` (what is missing), `closing` (stats and pairs), `until` (more seeds),
`inspection` (status, verify), `merging`.
"""
