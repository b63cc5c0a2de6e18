"""What a capture tells the person with the board, in words; viewer and terminal show the same."""

from __future__ import annotations

import numpy as np

from vergence.live.capture import CaptureSettings, CaptureState
from vergence.live.guide import instruction
from vergence.live.kept import Kept

TURN_DEG = 2.0
"""Turn that is asked for of an eye that takes no commands [degrees]: smaller ones bring as much."""
CELLS = (8, 6)
"""Columns and rows of the cells by which the coverage of an image is counted."""


def status(settings: CaptureSettings, state: CaptureState) -> str:
    """State what is reached, what to do next and what is missing, a line each."""
    reached, goal_mm = "not known yet", 1e3 * settings.goal_m
    if (accuracy_m := state.accuracy_m) is not None:
        reached = f"to {1e3 * accuracy_m:.1f} mm"
    lines = [
        f"{state.views} views; points at {settings.distance_m:g} m: {reached}, wanted "
        f"{goal_mm:g} mm",
        f"next: {next_step(settings, state)}",
    ]
    if not state.finished:
        lines.append(f"missing: {_missing(settings, state)}")
    return "\n".join(lines)


def next_step(settings: CaptureSettings, state: CaptureState) -> str:
    """Say what the person does next."""
    if state.finished:
        return f"nothing, {state.finished}"
    if state.sweep is not None:
        return "leave the board where it is; the eyes move to and fro"
    if state.to_keep:
        return "hold still"
    wanted = state.asked[0].joints
    told = instruction(state.head, state.asked[0], state.T_lbase_board)
    if settings.limits is not None or len(state.watched.readings) < len(wanted):
        return told
    turns = np.degrees(wanted - state.watched.readings[-len(wanted) :]) if len(wanted) else wanted
    names = settings.description.head_kinematics.readings
    far = [
        f"{n} by {turn:+.0f}" for n, turn in zip(names, turns, strict=True) if abs(turn) > TURN_DEG
    ]
    return f"{told}; turn {', '.join(far)} degrees" if far else told


def _missing(settings: CaptureSettings, state: CaptureState) -> str:
    covered = {
        name: coverage(state.kept, name, (camera.width, camera.height))
        for name, camera in settings.description.cameras.items()
    }
    parts = [f"{name} covered to {100 * part:.0f} %" for name, part in covered.items()]
    if state.for_camera:
        parts.insert(0, f"views of {state.for_camera}")
    if state.estimate is not None and state.estimate.problem:
        parts.append(f"no plan yet: {state.estimate.problem}")
    return "; ".join(parts)


def coverage(kept: tuple[Kept, ...], camera: str, size: tuple[int, int]) -> float:
    """Compute the part of an image's cells in which a corner of a board was seen."""
    seen = [view.corners[camera] for view in kept if camera in view.corners]
    if not seen:
        return 0.0
    corners = np.concatenate(seen)
    cells = np.floor(corners[np.isfinite(corners).all(axis=1)] / size * CELLS).astype(int)
    return len(np.unique(np.clip(cells, 0, np.array(CELLS) - 1), axis=0)) / np.prod(CELLS)
