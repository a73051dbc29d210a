"""Computes tasks in parallel, each once ever: by a pool of processes or the ranks of an MPI job.

Both are executors of ``concurrent.futures``: ``ProcessPoolExecutor`` and, under a launcher of MPI,
``mpi4py.futures.MPICommExecutor``, whose rank 0 hands out the work.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import cast

from opticcup_fem.studies.sweep.bar import Bar
from opticcup_fem.studies.sweep.cache import Record, ResultCache, Task
from opticcup_fem.studies.sweep.tasks import compute

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""One thread a process: the tasks are the parallelism."""


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
        for task, record in self._computed(missing):
            records[task] = record
        return [records[task] for task in tasks]

    def _computed(self, tasks: Sequence[Task]) -> Iterator[tuple[Task, Record]]:
        """Yield the records of tasks as they come; a task whose process dies is one that failed."""
        waiting = list(reversed(tasks))
        under_way: dict[Future[Record], Task] = {}
        while waiting or under_way:
            # no more than there are processes: if one dies, it died of one of these
            while waiting and len(under_way) < self._processes:
                task = waiting.pop()
                under_way[self._executor.submit(compute, task)] = task
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            try:
                for future in done:
                    record = future.result()
                    task = under_way.pop(future)
                    yield task, self._kept(task, record)
            except BrokenProcessPool:
                self._executor = _process_pool(self._processes)
                suspects = list(under_way.values())
                under_way.clear()
                for task in suspects:
                    yield task, self._kept(task, self._alone(task))

    def _alone(self, task: Task) -> Record:
        """Return the record of a task with no other under way."""
        try:
            return self._executor.submit(compute, task).result()
        except BrokenProcessPool:
            self._executor = _process_pool(self._processes)
            reason = "the process that computed it died (out of memory?)"
            return {"status": "failed", "reason": reason, "row": {}, "unforeseen": True}

    def _kept(self, task: Task, record: Record) -> Record:
        if not record.pop("unforeseen", False):
            self.cache.store(task, record)
        self.computed += 1
        self.bar.advance(failed=record["status"] == "failed")
        return record

    def close(self, patiently: bool) -> None:
        """Shut the executor down; if not ``patiently``, what is under way is abandoned."""
        self._executor.shutdown(wait=patiently, cancel_futures=True)


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
        # PETSc and SLEPc start together on all ranks; a task would start them on its own
        from mpi4py import MPI
        from mpi4py.futures import MPICommExecutor
        from petsc4py import PETSc  # noqa: F401
        from slepc4py import SLEPc  # noqa: F401

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
            engine.close(patiently=False)
            raise
        engine.close(patiently=True)


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
