"""Make the head's outer shell, a helmet with an opening for the eyes, and the crest on top of it.

Run from anywhere (the meshes are written beside this file):

    python models/cbi_head/assets/make_meshes.py

The surface is |x/a|^n + |y/b|^n + |z/c|^n = 1 about `CENTRE`, in coordinates of the body `head`
[m]. It is meshed in rings about the x axis, so that the first ring is the opening's edge.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ASSETS = Path(__file__).parent

CENTRE = np.array([-0.084, 0.0, 0.016])
SEMI_AXES = np.array([0.092, 0.086, 0.110])
"""The front ends at x = 8 mm: behind all that a wide camera sees at any angle of its eye."""
EXPONENT = 2.35
"""2 is an ellipsoid; a little more is boxier, and looks less like an egg."""

OPENING_CENTRE_Z = -0.004
OPENING_HALF_SIZE = np.array([0.0745, 0.046])
OPENING_EXPONENT = 4.0
"""A rectangle with round corners, seen from the front."""
LIP_DEPTH = 0.012

RAY_ORIGIN = np.array([CENTRE[0], 0.0, OPENING_CENTRE_Z])

CHIN_Z = -0.088
"""The shell is cut flat here, where the neck begins."""

AROUND, ALONG = 72, 18

CREST_HALF_WIDTH = 0.011
CREST_HEIGHT = 1.02
"""Of the crest over the shell, as a scale about the centre."""


@dataclass(frozen=True)
class Mesh:
    """A rectangular grid of vertices, shaded with the normals of the true surface."""

    vertices: NDArray[np.float64]
    """(rows, columns, 3) [m]"""
    normals: NDArray[np.float64]
    """(rows, columns, 3), unit vectors."""

    def obj(self, *, closed: bool) -> str:
        """Text of the OBJ file; `closed` joins the last column to the first."""
        rows, columns, _ = self.vertices.shape
        lines = ["# Made by make_meshes.py"]
        lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in self.vertices.reshape(-1, 3)]
        lines += [f"vn {x:.3f} {y:.3f} {z:.3f}" for x, y, z in self.normals.reshape(-1, 3)]
        for row in range(rows - 1):
            for column in range(columns if closed else columns - 1):
                a, b = row * columns + column + 1, row * columns + (column + 1) % columns + 1
                c, d = a + columns, b + columns
                lines += [f"f {i}//{i} {j}//{j} {k}//{k}" for i, j, k in ((a, c, b), (b, c, d))]
        return "\n".join(lines) + "\n"


def inside_shell(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the (..., 3) points are inside the closed surface."""
    return (np.abs((points - CENTRE) / SEMI_AXES) ** EXPONENT).sum(axis=-1) < 1.0


def inside_opening(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the (..., 3) points are in the opening, seen along x."""
    yz = points[..., 1:] - (0.0, OPENING_CENTRE_Z)
    return (np.abs(yz / OPENING_HALF_SIZE) ** OPENING_EXPONENT).sum(axis=-1) < 1.0


def surface(alpha: NDArray[np.float64], phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Surface points (N, 3) at angle alpha (N,) from the x axis and phi (N,) about it [rad]."""
    ray = np.stack((np.cos(alpha), np.sin(alpha) * np.cos(phi), np.sin(alpha) * np.sin(phi)), -1)
    low, high = np.zeros(len(alpha)), np.full(len(alpha), 0.3)
    for _ in range(50):
        mid = (low + high) / 2.0
        inside = inside_shell(RAY_ORIGIN + mid[:, None] * ray)
        low, high = np.where(inside, mid, low), np.where(inside, high, mid)
    return RAY_ORIGIN + low[:, None] * ray


def normal(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outward unit normals (..., 3) of the surface."""
    scaled = (points - CENTRE) / SEMI_AXES
    gradient = np.sign(scaled) * np.abs(scaled) ** (EXPONENT - 1.0) / SEMI_AXES
    return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)


def opening_edge(phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """The angle alpha (N,) at which the opening ends [rad]."""
    low, high = np.zeros(len(phi)), np.full(len(phi), np.pi / 2.0)
    for _ in range(50):
        mid = (low + high) / 2.0
        inside = inside_opening(surface(mid, phi))
        low, high = np.where(inside, mid, low), np.where(inside, high, mid)
    return low


def shell() -> Mesh:
    """The helmet: a lip that goes inwards from the opening, then rings to the back of the head."""
    phi = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    edge = opening_edge(phi)
    rings = [surface(edge + s * (0.9995 * np.pi - edge), phi) for s in np.linspace(0.0, 1.0, ALONG)]
    lip = rings[0] * (1.0, 0.94, 0.94) - (LIP_DEPTH, 0.0, 0.0)
    inwards = -np.stack((np.zeros(AROUND), np.cos(phi), np.sin(phi)), -1)
    vertices = np.stack([lip, rings[0], *rings])
    normals = np.stack([inwards, inwards, *(normal(ring) for ring in rings)])
    vertices[..., 2] = np.maximum(vertices[..., 2], CHIN_Z)
    return Mesh(vertices, normals)


def crest() -> Mesh:
    """A raised band from the opening over the top to the back of the head."""
    top = np.full(1, np.pi / 2.0)
    alpha = np.linspace(opening_edge(top)[0] + 0.12, 0.86 * np.pi, 28)
    ridge = surface(alpha, np.broadcast_to(top, alpha.shape))
    half_angle = np.arcsin(CREST_HALF_WIDTH / (ridge[:, 2] - RAY_ORIGIN[2]))
    columns, normals = [], []
    for across, height, upright in (
        (1.0, 0.97, False),
        (1.0, CREST_HEIGHT, False),
        (1.0, CREST_HEIGHT, True),
        (0.5, CREST_HEIGHT, True),
        (-0.5, CREST_HEIGHT, True),
        (-1.0, CREST_HEIGHT, True),
        (-1.0, CREST_HEIGHT, False),
        (-1.0, 0.97, False),
    ):
        points = surface(alpha, np.pi / 2.0 - across * half_angle)
        columns.append(RAY_ORIGIN + height * (points - RAY_ORIGIN))
        sideways = np.broadcast_to((0.0, np.sign(across), 0.0), points.shape)
        normals.append(normal(points) if upright else sideways)
    return Mesh(np.stack(columns, axis=1), np.stack(normals, axis=1))


def main() -> None:
    for name, mesh, closed in (("shell", shell(), True), ("crest", crest(), False)):
        path = ASSETS / f"{name}.obj"
        path.write_text(mesh.obj(closed=closed))
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
