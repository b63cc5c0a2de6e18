"""Tasks run side by side, and errors and interrupts end all of them."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from tasks import count_up, end, fail, opencv_threads, write_for_ever
from vergence.errors import VergenceError
from vergence.files import results_folder
from vergence.parallel import process_count, run_tasks


def alive(process: int) -> bool:
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except FileNotFoundError:
        return False
    return "State:\tZ" not in status


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_result_and_step_arrives(jobs):
    steps, results = [], {}
    tasks = [partial(count_up, name, count) for name, count in (("a", 3), ("b", 1), ("c", 2))]
    run_tasks(
        tasks,
        lambda result: results.update([result]),
        jobs=jobs,
        progress=lambda *step: steps.append(step),
    )
    assert set(results) == set("abc")
    for name, count in (("a", 3), ("b", 1), ("c", 2)):
        assert [step for step in steps if step[0] == name] == [
            (name, k, count) for k in range(count)
        ]
    assert (set(results.values()) == {os.getpid()}) == (jobs == 1)


@pytest.mark.parametrize("error", [VergenceError("One sentence."), ValueError("A slip.")])
def test_an_error_of_a_task_is_raised_and_ends_the_others(error, tmp_path):
    tasks = [partial(write_for_ever, tmp_path / "a.txt"), partial(fail, error)]
    begin = time.monotonic()
    with pytest.raises(type(error), match=str(error)), results_folder(tmp_path):
        run_tasks(tasks, print, jobs=2)
    assert time.monotonic() - begin < 30
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_vanishes_is_reported():
    with pytest.raises(VergenceError, match="ended before its work was done"):
        run_tasks([end, partial(count_up, "a", 2)], print, jobs=2)


SCRIPT = """
import os, signal, sys
from functools import partial
from pathlib import Path
sys.path.insert(0, {tests!r})
from tasks import write_for_ever
from vergence.files import results_folder
from vergence.parallel import run_tasks

def stop(*_):
    raise KeyboardInterrupt

def tell(*_):
    children = Path(f"/proc/{{os.getpid()}}/task/{{os.getpid()}}/children").read_text()
    print(children, flush=True)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    folder = Path(sys.argv[1])
    try:
        with results_folder(folder):
            run_tasks(
                [partial(write_for_ever, folder / name) for name in "ab"],
                print, jobs=2, progress=tell,
            )
    except KeyboardInterrupt:
        print("stopped")
"""


@pytest.mark.parametrize(
    ("number", "working"),
    [(signal.SIGINT, True), (signal.SIGTERM, False), (signal.SIGKILL, True)],
)
def test_a_stopped_run_ends_its_processes_without_a_word(number, working, tmp_path):
    """Signals to the whole group, as Ctrl-C: once tasks work, and while processes start."""
    script, out = tmp_path / "script.py", tmp_path / "out"
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent)))
    run = subprocess.Popen(
        [sys.executable, str(script), str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert run.stdout is not None
    children: list[str] = []
    if working:
        children = [run.stdout.readline().split() for _ in "ab"][-1]
        assert len(children) >= 2
    else:
        while not out.exists():
            time.sleep(0.01)
    if number == signal.SIGKILL:
        run.kill()
    else:
        os.killpg(run.pid, number)
    printed, errors = run.communicate(timeout=30)
    if number != signal.SIGKILL:
        assert (run.returncode, errors) == (0, "")
        assert printed.splitlines()[-1] == "stopped"
        assert not out.exists()
    end_s = time.monotonic() + 20
    while any(alive(int(child)) for child in children) and time.monotonic() < end_s:
        time.sleep(0.1)
    assert not any(alive(int(child)) for child in children)


def test_zero_processes_are_refused():
    for jobs in (0, -2):
        with pytest.raises(VergenceError, match=f"-1 for all cores, found {jobs}"):
            process_count(jobs)
    assert process_count(3) == 3
    assert process_count(-1) >= 1


def test_processes_share_the_cores_among_threads_of_opencv():
    counts = []
    run_tasks([opencv_threads, opencv_threads], counts.append, jobs=2)
    assert counts == 2 * [max(1, process_count(-1) // 2)]
