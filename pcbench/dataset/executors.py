"""Where tasks run: in this process, on all cores or accelerators, or on Dask's workers.

An executor is a function (work, tasks) -> reports, in the order in which they finish. `work(task, hold)` is a pure
function that writes complete files and computes only while it holds a device (`with hold() as device`). `tasks` are
generated when devices become free, so the memory does not grow with their number.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import cache
from itertools import islice
from queue import SimpleQueue
from threading import Event, Lock, Semaphore
from typing import TYPE_CHECKING, Protocol, TypeVar

import jax

from pcbench.engine import runner
from pcbench.errors import UserError, redact_address
from pcbench.runtime import config, ending
from pcbench.runtime.memory import memory_budget

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

QUEUED = 3  # tasks per Dask worker: one computing, one writing, one waiting
TASK_MEMORY = 2.0**30  # bytes of results per task, on workers of unknown memory
ALLOWED_FAILURES = 10  # how often a task may lose its worker
CONNECT_TIMEOUT = "20s"  # until a scheduler answers
NO_WORKER_TIMEOUT = "120s"  # if all workers of this machine have ended; others may start again
T = TypeVar("T")
R = TypeVar("R")
Hold = Callable[[], AbstractContextManager[jax.Device | None]]  # a device, held while it computes; None: any


class Executor(Protocol):
    """A function that runs tasks and yields the result of `work` for each."""

    def __call__(self, work: Callable[[T, Hold], R], tasks: Iterable[T], /) -> Iterator[R]:
        """Yield reports in the order in which tasks finish."""


def task_memory(memory: str | int | None, address: str | None, workers: int | None, count: int | None) -> float:
    """Return the memory [bytes] for the results of one task: the limit divided by two tasks per device.

    The memory of remote workers is unknown. It is TASK_MEMORY, unless `memory` gives that of each worker.
    """
    if workers is not None and address != "local":
        raise UserError(f"--workers: got {workers} without --dask local, expected both; leave --workers out.")
    if address not in (None, "local"):
        return TASK_MEMORY if memory is None else memory_budget(memory) / 2
    n_tasks = (workers or runner.cores()) if address else len(runner.devices(count))
    return memory_budget(memory) / (2 * max(n_tasks, 1))


@contextmanager
def local_executor(count: int | None = None) -> Iterator[Executor]:
    """Yield the executor of this process, with `count` simultaneous calls; default: one per core or accelerator.

    Twice as many tasks as devices are under way, so one can compute while another writes its files. After Ctrl-C
    pcbench waits for files that are being written. It does not wait for computations, which may take minutes; they
    write nothing when they end.
    """
    free_devices: SimpleQueue[jax.Device] = SimpleQueue()
    for device in runner.devices(count):
        free_devices.put(device)
    n_tasks = 2 * free_devices.qsize()
    stop, write_slots = Event(), Semaphore(n_tasks)
    pool = ThreadPoolExecutor(n_tasks, "pcbench")

    def check_stop() -> None:
        if stop.is_set():
            raise CancelledError

    def run_task(work: Callable[[T, Hold], R], task: T) -> R:
        with ExitStack() as until_done:

            @contextmanager
            def hold() -> Iterator[jax.Device]:
                device = free_devices.get()
                try:
                    check_stop()
                    yield device
                finally:
                    free_devices.put(device)
                until_done.enter_context(write_slots)
                check_stop()

            return work(task, hold)

    def execute(work: Callable[[T, Hold], R], tasks: Iterable[T]) -> Iterator[R]:
        queue, futures = iter(tasks), set[Future[R]]()
        while True:
            futures |= {pool.submit(run_task, work, t) for t in islice(queue, n_tasks - len(futures))}
            if not futures:
                return
            complete, futures = wait(futures, return_when=FIRST_COMPLETED)
            for future in complete:
                yield future.result()

    try:
        yield execute
    except (KeyboardInterrupt, GeneratorExit):
        stop.set()
        pool.shutdown(wait=False, cancel_futures=True)
        for _ in range(n_tasks):  # none writes any more once this has all of them
            write_slots.acquire()
        raise
    finally:
        pool.shutdown(wait=not stop.is_set(), cancel_futures=True)  # none writes on when this has ended


@contextmanager
def dask(address: str, workers: int | None = None) -> Iterator[Executor]:
    """Yield the executor of a Dask cluster: a scheduler's address, or "local" for some processes of this machine.

    A worker computes one task at a time on one device. With two threads it writes the files of another task meanwhile.
    If a worker dies, another one gets its tasks. A task that runs twice writes the same file. All workers must have
    access to the dataset. Raises UserError if there is no such cluster.
    """
    try:
        import distributed
    except ImportError:
        raise UserError("--dask: Dask is not installed, expected it: pip install 'pcbench[dask]'.") from None
    from asyncio import CancelledError as AsyncCancelled

    cluster, client = _connect(address, workers)
    no_workers = getattr(distributed.scheduler, "NoWorkerError", ())  # in releases with that timeout

    def execute(work: Callable[[T, Hold], R], tasks: Iterable[T]) -> Iterator[R]:
        queue, futures = iter(tasks), distributed.as_completed(loop=client.loop)

        def feed() -> None:
            room = QUEUED * max(len(client.nthreads()), 1)
            for task in islice(queue, max(room - futures.count(), 0)):
                futures.add(client.submit(_run_on_worker, work, task, pure=False))

        feed()
        for future in futures:
            try:
                report = future.result()
            except distributed.KilledWorker:
                raise UserError(
                    "--dask: a task lost its worker several times, expected workers that stay alive; check their memory, and "
                    "run the same command again to continue."
                ) from None
            except no_workers:
                raise UserError(
                    "--dask: all workers have ended and none restarted, expected workers that live; look at their output, "
                    "or leave --dask out."
                ) from None
            except (CancelledError, AsyncCancelled, OSError) as error:
                raise UserError(
                    f"--dask: the scheduler has ended ({type(error).__name__}), expected one that runs until the study ends; "
                    "run the same command again to continue."
                ) from None
            future.release()
            feed()
            yield report

    try:
        yield execute
    finally:
        with ending.uncut():  # its processes end with it
            with suppress(Exception):  # a cluster that is gone is closed
                client.close(timeout=5)
            if cluster is not None:
                with suppress(Exception):
                    cluster.close(timeout=10)


def _connect(address: str, workers: int | None) -> tuple["LocalCluster | None", "Client"]:
    """Return the client of a cluster, and the cluster if it is of this machine; raise UserError if there is none."""
    import distributed
    from dask import config as dask_config

    dask_config.set({"distributed.scheduler.allowed-failures": ALLOWED_FAILURES})
    try:
        cluster = _local(workers) if address == "local" else None
        client = distributed.Client(cluster or address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except RuntimeError:  # its processes import the script that started them, and come here again
        raise UserError(
            '--dask: the workers did not start, expected a script that runs below `if __name__ == "__main__":`, as spawned '
            "processes need it; put it there."
        ) from None
    except (OSError, ValueError, TypeError) as error:
        raise UserError(
            f"--dask: got {redact_address(address)!r}, which does not respond ({type(error).__name__}); expected 'local' or "
            "the address of a running scheduler such as tcp://10.0.0.1:8786."
        ) from None
    return cluster, client


def _local(workers: int | None) -> "LocalCluster":
    """A cluster of spawned processes on this machine, one device each; of its two threads one computes at a time."""
    if runner.devices()[0].platform != "cpu":
        raise UserError(
            "--dask: got 'local' on a machine with accelerators, all of which this process uses by itself; expected a "
            "scheduler's address; leave --dask out."
        )
    from dask import config as dask_config
    from distributed import LocalCluster

    dask_config.set({"distributed.scheduler.no-workers-timeout": NO_WORKER_TIMEOUT})
    return LocalCluster(
        n_workers=workers or runner.cores(),
        threads_per_worker=2,  # one computes while the other writes
        processes=True,
        dashboard_address="127.0.0.1:0",  # any port that is free, for this machine only
        memory_limit=None,
        env=dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
        silence_logs="CRITICAL",
    )


def _run_on_worker(work: Callable[[T, Hold], R], task: T) -> R:
    """Run a task in a worker's process, which is configured at its first task and computes one task at a time."""
    _set_up()
    return work(task, _exclusive_device)


@contextmanager
def _exclusive_device() -> Iterator[None]:
    with _DEVICE_LOCK:
        yield


_set_up = cache(config.setup)
_DEVICE_LOCK = Lock()
