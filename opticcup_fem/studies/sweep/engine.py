"""Computes tasks in parallel, each once ever: by a pool of processes or the ranks of an MPI job.

Both are executors of ``concurrent.futures``: ``ProcessPoolExecutor`` and, under a launcher of MPI,
``mpi4py.futures.MPICommExecutor``, whose rank 0 hands out the work.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import cast

from opticcup_fem.studies.sweep.bar import Bar
from opticcup_fem.studies.sweep.cache import Record, ResultCache, Task
from opticcup_fem.studies.sweep.tasks import compute

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""One thread a process: the tasks are the parallelism."""

MOST_DEATHS = 2
"""A task that was under way whenever a worker died, this often, is given up."""


class Engine:
    """Runs tasks through an executor and a cache.

    Attributes:
        cache: The records.
        computed: How many tasks were computed, not found.
    """

    def __init__(self, executor: Executor, processes: int, cache: ResultCache, bar: Bar) -> None:
        """Take what computes.

        Args:
            executor: The executor.
            processes: Its size.
            cache: Where records are kept.
            bar: Shows the progress.
        """
        self.cache, self.bar, self.computed = cache, bar, 0
        self._executor, self._processes = executor, processes

    def run(self, tasks: Sequence[Task], what: str = "computing") -> list[Record]:
        """Return the records of tasks in their order, from the cache where they are there.

        Args:
            tasks: The tasks; equal ones are computed once.
            what: Name of this batch for the progress bar.
        """
        records: dict[Task, Record] = {}
        for task in dict.fromkeys(tasks):
            known = self.cache.load(task)
            if known is not None:
                records[task] = known
        missing = [task for task in dict.fromkeys(tasks) if task not in records]
        self.bar.begin(what, len(missing), len(records))
        deaths: Counter[Task] = Counter()
        while missing:
            futures: dict[Future[Record], Task] = {}
            try:
                futures = {self._executor.submit(compute, task): task for task in missing}
                for future in as_completed(futures):
                    records[futures[future]] = self._kept(futures[future], future.result())
            except BrokenProcessPool:
                deaths.update(t for t in futures.values() if t not in records)
                self._restart(missing, records, deaths)
            missing = [task for task in missing if task not in records]
        return [records[task] for task in tasks]

    def _kept(self, task: Task, record: Record) -> Record:
        if not record.pop("unforeseen", False):
            self.cache.store(task, record)
        self.computed += 1
        self.bar.advance(failed=record["status"] == "failed")
        return record

    def _restart(
        self, tasks: Sequence[Task], records: dict[Task, Record], deaths: Counter[Task]
    ) -> None:
        """Start a new pool after a worker died; give up the task that it died of.

        Which task that was is known once tasks are handed out one at a time.
        """
        self._executor = _process_pool(self._processes)
        if max(deaths.values()) < MOST_DEATHS:
            return
        for task in [task for task in tasks if task not in records]:
            try:
                record = self._executor.submit(compute, task).result()
            except BrokenProcessPool:
                self._executor = _process_pool(self._processes)
                reason = "the process that computed it died (out of memory?)"
                records[task] = {"status": "failed", "reason": reason, "row": {}}
                self.bar.advance(failed=True)
            else:
                records[task] = self._kept(task, record)

    def close(self, wait: bool) -> None:
        """Shut the executor down; without ``wait`` what is under way is abandoned."""
        self._executor.shutdown(wait=wait, cancel_futures=True)


@contextmanager
def engine_of(
    cache: ResultCache, processes: int | None = None, shown: bool = True
) -> Iterator[Engine | None]:
    """Yield an engine; None on the ranks of an MPI job that have done their work for rank 0.

    Args:
        cache: Where records are kept.
        processes: Size of the pool of processes, one a core by default; without meaning under MPI.
        shown: Whether progress is shown.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")
    if under_mpi():
        from mpi4py import MPI
        from mpi4py.futures import MPICommExecutor

        with MPICommExecutor(MPI.COMM_WORLD, root=0) as found:
            executor: Executor | None = cast("Executor | None", found)
            if executor is None:
                yield None
            else:
                with Bar(shown) as bar:
                    yield Engine(executor, MPI.COMM_WORLD.size - 1, cache, bar)
        return
    count = processes or len(os.sched_getaffinity(0))
    with Bar(shown) as bar:
        engine = Engine(_process_pool(count), count, cache, bar)
        try:
            yield engine
        except BaseException:
            engine.close(wait=False)
            raise
        engine.close(wait=True)


def under_mpi() -> bool:
    """Tell whether this process is one of several of an MPI job."""
    launched = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_NTASKS")
    if not any(name in os.environ for name in launched):
        return False
    from mpi4py import MPI

    return bool(MPI.COMM_WORLD.size > 1)


def _process_pool(processes: int) -> ProcessPoolExecutor:
    # a forked copy of a process that runs threads or MPI may hang
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent)


def _end_with_parent() -> None:
    """Let a worker end when the process that started it is killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()
