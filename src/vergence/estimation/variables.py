"""Unknowns of an estimate: named shared blocks, and the elements of one latent kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array


def add(value: Any, step: Array) -> Any:
    """Retract in a vector space."""
    return value + step


@dataclass(frozen=True, eq=False)
class Block:
    """A shared unknown with s degrees of freedom."""

    value: Any
    scale: Array
    """(s,) standard deviation with which each is known before any data: a drawing, a ruler."""
    retract: Callable[[Any, Array], Any] = add
    """Maps the value and a step (s,) to the new value; raises ValueError for impossible values."""
    free: NDArray[np.bool_] | None = None
    """(s,) of bool: which may change; None: all."""
    nuisance: bool = False
    """Whether observability is judged after eliminating this block."""


@dataclass(frozen=True, eq=False)
class Latent:
    """B latent elements with n degrees of freedom each."""

    value: Array
    """(B, ...)."""
    size: int
    """n."""
    retract: Callable[[Array, Array], Array] = add
    """Maps the values and steps (B, n) to the new values."""


NO_LATENT = Latent(np.zeros((0, 0)), 0)
"""No latent elements, for problems whose unknowns are all in blocks."""


@dataclass(frozen=True, eq=False)
class Variables:
    """Values of all unknowns. G counts the degrees of freedom of the shared ones."""

    shared: Mapping[str, Block]
    latent: Latent = field(default=NO_LATENT)

    def __getitem__(self, name: str) -> Any:
        """Return the value of a shared block."""
        return self.shared[name].value

    @cached_property
    def _columns(self) -> dict[str, NDArray[np.intp]]:
        ends = np.cumsum([len(block.scale) for block in self.shared.values()], dtype=np.intp)
        return {
            name: np.arange(end - len(block.scale), end)
            for end, (name, block) in zip(ends, self.shared.items(), strict=True)
        }

    def columns(self, name: str) -> NDArray[np.intp]:
        """Return the places (s,) of a block in the vector of shared unknowns."""
        return self._columns[name]

    @property
    def size(self) -> int:
        """G."""
        return sum(len(block.scale) for block in self.shared.values())

    def stacked(self, value: Callable[[Block], Any]) -> np.ndarray:
        """Collect a property (G,) of all blocks, which may be one value a block."""
        parts = [np.broadcast_to(value(b), b.scale.shape) for b in self.shared.values()]
        return np.concatenate(parts) if parts else np.zeros(0)

    @property
    def free(self) -> NDArray[np.bool_]:
        """(G,) of bool: which shared unknowns may change."""
        return self.stacked(lambda b: True if b.free is None else b.free).astype(bool)

    def scaled_basis(self) -> Array:
        """Make a direction (G, F) for each free unknown, as long as its scale."""
        return np.diag(self.stacked(lambda b: b.scale))[:, self.free]

    def retract(self, shared: Array, latent: Array) -> Variables:
        """Change the unknowns by (G,) and (B, n); ValueError if that is impossible."""
        moved = {
            name: replace(block, value=block.retract(block.value, shared[self.columns(name)]))
            for name, block in self.shared.items()
        }
        value = self.latent.value
        if value.size:
            value = self.latent.retract(value, latent)
        return Variables(moved, replace(self.latent, value=value))
