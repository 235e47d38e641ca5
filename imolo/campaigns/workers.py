"""Run tasks in other processes, on this machine or on a Dask cluster, and repeat what a dying worker left undone."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import BrokenProcessPool

from imolo.config.experiment import ParallelConfig
from imolo.errors import WorkerError
from imolo.machine.extras import import_extra

Task = TypeVar("Task")
Result = TypeVar("Result")

CONNECT_TIMEOUT = 10.0  # [s] for the scheduler to answer, and for the first worker to be there


def run_on_cores(
    run: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int,
    retries: int,
    was_begun: Callable[[Task], bool],
) -> Iterator[tuple[int, Result]]:
    """Run tasks in processes of this machine.

    When a worker dies, all others end with it. What was under way is then repeated alone, so that a task that kills its
    worker again is known, and has the whole memory; the rest goes on as before.

    Args:
        run: What to do with a task.
        tasks: Named in errors by their text.
        jobs: Number of processes.
        retries: How often a task whose worker died is repeated.
        was_begun: Says whether a task was under way when the workers ended.

    Yields:
        Number of a task and its result, in the order in which they end.

    Raises:
        WorkerError: A task lost its worker each time.
    """
    left = dict(enumerate(tasks))

    def attempt(numbers: Sequence[int]) -> Iterator[tuple[int, Result]]:
        ended: Iterable[tuple[int, Result]] = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
            delayed(_numbered)(run, number, tasks[number]) for number in numbers
        )
        for number, result in ended:
            del left[number]
            yield number, result

    failed_starts = 0
    while left:
        try:
            yield from attempt(list(left))
        except BrokenProcessPool as error:
            begun = [number for number, task in left.items() if was_begun(task)]
            failed_starts = 0 if begun else failed_starts + 1
            if failed_starts > retries:
                raise WorkerError(f"workers died {failed_starts} times before they began anything: {error}") from error
        else:
            continue
        for number in begun:
            for deaths in range(1, retries + 2):
                if deaths > retries:
                    raise _gave_up(tasks[number], f"{deaths} times")
                try:
                    yield from attempt([number])
                    break
                except BrokenProcessPool:
                    continue


def run_on_dask(
    run: Callable[[Task], Result], tasks: Sequence[Task], parallel: ParallelConfig
) -> Iterator[tuple[int, Result]]:
    """Run tasks on the workers of a Dask scheduler, which itself repeats those of a worker that died.

    joblib's own Dask backend waits forever for a task that the scheduler gave up, so the scheduler is asked directly.

    Args:
        run: What to do with a task.
        tasks: Named in errors by their text.
        parallel: Where the scheduler is.

    Yields:
        Number of a task and its result, in the order in which they end.

    Raises:
        MissingToolError: Dask is not installed.
        WorkerError: The scheduler or its workers are not there, or a task lost its worker too often.
    """
    distributed = import_extra("distributed", "cluster")
    address = parallel.address
    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise WorkerError(
            f"no Dask scheduler answers at {address}; start one with `dask scheduler`, or give its --scheduler"
        ) from error
    lost: list[int] = []

    def attempt(numbers: Iterable[int]) -> Iterator[tuple[int, Result]]:
        futures = {client.submit(run, tasks[number], pure=False): number for number in numbers}
        for future in distributed.as_completed(futures, loop=client.loop):
            number = futures[future]
            try:
                result = future.result()
            except distributed.KilledWorker:
                lost.append(number)
            except distributed.CancelledError as error:
                raise WorkerError(
                    f"the Dask scheduler at {address} is gone; start it and run the same command again to go on"
                ) from error
            else:
                yield number, result

    try:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
        except TimeoutError as error:
            raise WorkerError(
                f"the Dask scheduler at {address} has no workers; start some with `dask worker {address} --nthreads 1`"
            ) from error
        yield from attempt(range(len(tasks)))
        # Dask blames whatever a dying worker had, results included; alone, the guilty one is known.
        suspects, lost = lost, []
        for number in suspects:
            yield from attempt([number])
            if lost:
                raise _gave_up(tasks[number], "again and again, also alone")
    finally:
        # What the workers still hold or wait for is forgotten with its futures.
        client.close()


def _numbered(run: Callable[[Task], Result], number: int, task: Task) -> tuple[int, Result]:
    return number, run(task)


def _gave_up(task: object, how_often: str) -> WorkerError:
    return WorkerError(
        f"{task} was given up: its worker died {how_often}; see the system's log for a lack of memory, or run it "
        "with --jobs 1 to see it crash"
    )
