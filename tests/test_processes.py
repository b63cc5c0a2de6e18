"""Tasks in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial

import pytest

from tasks import count_up, end, fail, opencv_threads, wait_for_ever, write
from vergence.errors import VergenceError
from vergence.processes import Run, process_count, processes
from vergence.progress import silent
from vergence.writing import finished_files


@pytest.fixture(scope="module")
def two() -> Iterator[Run]:
    """Run tasks in two processes, for tests that leave these running."""
    with processes(2) as run:
        yield run


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_result_and_step_arrives_in_its_tasks_order(jobs, two):
    told = []
    with processes(1) as one:
        run = {1: one, 2: two}[jobs]
        tasks = [partial(count_up, name, steps) for name, steps in (("a", 3), ("b", 1), ("c", 2))]
        found = list(run(tasks, lambda *step: told.append(step)))
        again = list(run(tasks[:2], silent))
    for name, steps in (("a", 3), ("b", 1), ("c", 2)):
        assert [step for task, step, _ in found if task == name] == list(range(steps))
        assert [step for step in told if step[0] == name] == [
            (name, k, steps) for k in range(steps)
        ]
    workers = {process for _, _, process in found}
    assert (workers == {os.getpid()}) == (jobs == 1)
    assert {process for _, _, process in again} <= workers  # each is started once


def test_files_that_a_task_writes_count_as_written(tmp_path, two):
    paths = [tmp_path / "a", tmp_path / "b"]
    assert set(two([partial(write, path) for path in paths], silent)) == set(paths)
    assert set(paths) <= set(finished_files())


def test_a_process_that_ended_between_tasks_is_reported():
    with processes(2) as run:
        found = run([partial(count_up, name, 1) for name in "ab"], silent)
        for process in {process for _, _, process in found}:
            os.kill(process, signal.SIGKILL)
        time.sleep(0.5)
        with pytest.raises(VergenceError, match="ended before its work was done"):
            list(run([partial(count_up, name, 1) for name in "cd"], silent))


@pytest.mark.parametrize("error", [VergenceError("One sentence."), ValueError("A slip.")])
def test_an_error_of_a_task_is_raised_and_ends_the_others(error, tmp_path):
    left = tmp_path / "left"
    with pytest.raises(type(error), match=str(error)), processes(2) as run:
        for _ in run([partial(wait_for_ever, left), partial(fail, error)], silent):
            pass
    assert not left.exists() or left.read_text() == "cleaned up"


def test_an_interrupted_run_lets_its_tasks_clean_up(tmp_path):
    def interrupt(*step: object) -> None:
        raise KeyboardInterrupt

    lefts = [tmp_path / "a", tmp_path / "b"]
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), processes(2) as run:
        list(run([partial(wait_for_ever, left) for left in lefts], interrupt))
    assert time.monotonic() - begin < 30
    assert any(left.exists() for left in lefts)


STOPPED_AS_A_PROCESS_STARTS = """
import os, signal, time
from functools import partial
from multiprocessing import resource_tracker, util
from vergence.processes import processes
from vergence.progress import silent

started = util.spawnv_passfds

def stop(*arguments):
    number = started(*arguments)
    time.sleep(0.1)
    {stop}
    return number

def interrupt(*_):
    raise KeyboardInterrupt

if __name__ == "__main__":
    resource_tracker.ensure_running()  # a process of its own, with its own guard
    util.spawnv_passfds = stop
    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGTERM, interrupt)
    try:
        with processes(2) as run:
            list(run([partial(print, "ran")] * 2, silent))
    except KeyboardInterrupt:
        print("stopped")
"""


@pytest.mark.parametrize(
    "stop",
    [
        "os.kill(os.getpid(), signal.SIGTERM)",
        "os.killpg(0, signal.SIGTERM)",
        "os.killpg(0, signal.SIGINT)",  # as Ctrl-C in a terminal
    ],
)
def test_a_process_that_is_stopped_as_it_starts_says_nothing(stop, tmp_path):
    script = tmp_path / "stopped.py"
    script.write_text(STOPPED_AS_A_PROCESS_STARTS.format(stop=stop))
    command = [sys.executable, str(script)]
    done = subprocess.run(
        command, capture_output=True, text=True, start_new_session=True, check=False, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "stopped\n", "")


def test_a_process_that_vanishes_is_reported():
    with pytest.raises(VergenceError, match="ended before its work was done"), processes(2) as run:
        list(run([end, partial(count_up, "a", 2)], silent))


def test_no_process_at_all_is_refused():
    for jobs in (0, -2):
        with pytest.raises(VergenceError, match=f"-1 for all cores, found {jobs}"):
            process_count(jobs)
    assert process_count(3) == 3
    assert process_count(-1) >= 1


def test_processes_share_the_cores_among_threads_of_opencv(two):
    counts = list(two([opencv_threads, opencv_threads], silent))
    assert counts == 2 * [max(1, process_count(-1) // 2)]
