"""Check the time stamps of a recording: frozen, repeated, backward, of two clocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from vergence.data.description import Description
from vergence.errors import VergenceError, counted
from vergence.findings import Finding, warning
from vergence.recordings.moments import joint_track
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import Scan

FROZEN_SHARE = 0.5
"""Share of stamps that repeat the one before, above which they do not tell times."""
CLOCKS_S = 1.0
"""Difference of delays [s] above which two channels are taken to be stamped by two clocks; images
of USB cameras are up to 0.9 s late."""


def check_stamps(
    scanned: Scan, mapped: RecordingMap, description: Description
) -> tuple[Finding, ...]:
    """Note stamps that are repeated or go backward, and clocks that differ.

    VergenceError if images and joint readings cannot be brought together by their stamps.
    """
    images = {
        f"images of {source.images}": scanned.images[source.images].stamp_ns
        for source in mapped.cameras.values()
    }
    joints = {
        f"readings of {joint.column}": joint_track(scanned, joint.column).stamp_ns
        for joint in description.sources.values()
    }
    poses = {f"poses of {child}": track.stamp_ns for (_, child), track in scanned.poses.items()}
    other = ' If the recorder has one clock, set stamps = "received" in the map.'
    remedy = other if mapped.stamps == "header" else ""
    findings = [
        finding for what, at in (images | joints).items() for finding in _of(what, at, remedy)
    ]
    moving = {what: at for what, at in (joints | poses).items() if len(at) > 1}
    for a, image_ns in images.items():
        for b, joint_ns in moving.items():
            if image_ns.max() < joint_ns.min() or joint_ns.max() < image_ns.min():
                raise VergenceError(
                    f"The stamps of two clocks do not meet: {a} are of {_span(image_ns)}, {b} of "
                    f"{_span(joint_ns)}.{remedy}"
                )
    used = [source.images for source in mapped.cameras.values()]
    used += [channel for channel, _ in scanned.joints]
    delays = {name: scanned.delay_ns[name] for name in used if name in scanned.delay_ns}
    return (*findings, *_different_delays(delays, remedy))


def _of(what: str, at: np.ndarray, remedy: str) -> Iterator[Finding]:
    """Check the stamps (N,) of one track in the order of the recording."""
    steps, where = np.diff(at), what.rpartition(" of ")[2]
    repeated, backward = int((steps == 0).sum()), int((steps < 0).sum())
    if repeated > FROZEN_SHARE * len(steps) > 1:
        raise VergenceError(
            f"The stamps of {what} stand still: {repeated} of {len(at)} repeat the one before."
            f"{remedy}"
        )
    if repeated:
        sentence = (
            f"{counted(repeated, 'stamp')} of {what} repeat the one before; the first counts."
        )
        yield warning("repeated-stamps", sentence, where)
    if backward:
        yield warning(
            "backward-stamps",
            f"{counted(backward, 'stamp')} of {what} are earlier than the one before, by up to "
            f"{-steps.min() * 1e-9:.3g} s; they were put in order.",
            where,
        )


def _span(at: np.ndarray) -> str:
    return f"{at.min() * 1e-9:.3f} to {at.max() * 1e-9:.3f} s"


def _different_delays(delay_ns: Mapping[str, int], remedy: str) -> Iterator[Finding]:
    """Warn of channels whose stamps are as far from the times of receipt as two clocks are."""
    if not delay_ns:
        return
    first, last = min(delay_ns, key=delay_ns.__getitem__), max(delay_ns, key=delay_ns.__getitem__)
    apart_s = (delay_ns[last] - delay_ns[first]) * 1e-9
    if apart_s > CLOCKS_S:
        yield warning(
            "two-clocks",
            f"Messages of {last} were received {delay_ns[last] * 1e-9:.3g} s after their stamps, "
            f"those of {first} {delay_ns[first] * 1e-9:.3g} s: the stamps seem to be of two clocks."
            f"{remedy}",
            last,
        )
