"""A quick look at many sets of effects: whitened columns, projected on what is in the model.

Least squares of one more column beside others needs only products of columns. They are formed once
for each power S, for all atoms together; the sets that look best are then fitted exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.regression import Base, Rows, eigenbasis, solve_normal

_RANK = 1e-7  # a column that keeps less of its power beside the declared ones is one of them

Columns = Float[np.ndarray, "*batch columns"]


@dataclass(frozen=True)
class Beside:
    """All columns of the terms beside some others, which are projected out.

    Leading axes: of several such others, each by itself.

    Attributes:
        inside: our columns in an orthonormal basis of the others, shape (*, others, columns).
        square: what is left of each column's power; 1 where the column is among the others.
        kept: columns that are not among the others.
        rho: what a column takes of the target's root power if it is added alone.
    """

    inside: Float[np.ndarray, "*batch others columns"]
    square: Columns
    kept: Bool[np.ndarray, "*batch columns"]
    rho: Columns


class Terms:
    """Atoms that add columns to the model."""

    def __init__(self, atoms: Sequence[CandidateColumns], power: Rows):
        self.weight = 1.0 / np.sqrt(power)
        widths = [one.columns.shape[1] for one in atoms]
        self.owner = np.repeat(np.arange(len(atoms)), widths)
        self.first = np.concatenate([[0], np.cumsum(widths, dtype=int)])
        stacked = np.concatenate([one.columns for one in atoms], axis=1) if atoms else None
        rows = np.zeros((len(power), 0)) if stacked is None else stacked
        self.white = rows * self.weight[:, None]
        self.gram = self.white.T @ self.white

    def part(self, atom: int) -> slice:
        """Columns of one atom."""
        return slice(self.first[atom], self.first[atom + 1])

    def beside(self, columns: Float[np.ndarray, "rows others"], target: Rows) -> Beside:
        """Our columns beside those of a model."""
        matrix = columns * self.weight[:, None]
        length = np.linalg.norm(matrix, axis=0)
        q, _ = np.linalg.qr(matrix / np.where(length > 0, length, 1.0))
        white = target * self.weight
        return self.left(q.T @ self.white, self.white.T @ (white - q @ (q.T @ white)))

    def left(self, inside: np.ndarray, along: np.ndarray) -> Beside:
        """From the columns in a basis, and their products with the rest of the target."""
        whole = np.diagonal(self.gram)
        square = whole - np.sum(inside**2, axis=-2)
        kept = square > _RANK * whole
        square = np.where(kept, square, 1.0)
        return Beside(inside, square, kept, np.where(kept, along / np.sqrt(square), 0.0))

    def by_atom(self, beside: Beside) -> Float[np.ndarray, "*batch atoms"]:
        """What each atom takes away: ρ² of one column, jointly of two."""
        first, width = self.first[:-1], np.diff(self.first)
        out = beside.rho[..., first] ** 2
        pair = width > 1
        i, k = first[pair], first[pair] + 1
        inside, square, rho = beside.inside, beside.square, beside.rho
        both = self.gram[i, k] - np.sum(inside[..., i] * inside[..., k], axis=-2)
        # Root by root: the product of small squares would be rounded to zero.
        correlation = both / (np.sqrt(square[..., i]) * np.sqrt(square[..., k]))
        out[..., pair] = _joint(rho[..., i], rho[..., k], correlation)
        return out

    def pairs(self, beside: Beside, count: int) -> list[tuple[float, int, int]]:
        """Pairs of columns of different atoms that take away most together, and how much."""
        scale = np.sqrt(beside.square)
        products = self.gram - beside.inside.T @ beside.inside
        gain = _joint(beside.rho[:, None], beside.rho, products / np.outer(scale, scale))
        usable = np.outer(beside.kept, beside.kept) & (self.owner[:, None] < self.owner)
        gain = np.where(usable, gain, 0.0)
        flat = np.argsort(gain, axis=None)[::-1][:count]
        rows, others = np.unravel_index(flat, gain.shape)
        return [(float(gain[i, k]), int(i), int(k)) for i, k in zip(rows, others, strict=True)]


class Changes:
    """Atoms of one width that change the declared part of the model, each a model of its own."""

    def __init__(self, atoms: Sequence[CandidateColumns], base: Base, power: Rows):
        weight = 1.0 / np.sqrt(power)
        self.atoms = list(atoms)
        self._gains = slice(len(base.free), None)
        parameters = atoms[0].placed.effect.gains
        self._low = np.array([one.lower for one in parameters])
        self._high = np.array([one.upper for one in parameters])
        own = [np.concatenate([_slopes(one)[:, base.free], one.columns], axis=1) for one in atoms]
        self.rows = np.stack(own).transpose(0, 2, 1) * weight  # (atoms, width, rows)
        self.target = np.stack([_target(one) for one in atoms]) * weight
        self.weight = weight
        self.gram = self.rows @ self.rows.transpose(0, 2, 1)
        self.right = np.einsum("awr,ar->aw", self.rows, self.target)
        self.square = np.sum(self.target**2, axis=1)

    def costs(self, columns: Float[np.ndarray, "rows others"]) -> Float[np.ndarray, " atoms"]:
        """Σ |R|²/S of each atom beside others; infinite where its own gain is not physical."""
        white = columns * self.weight[:, None]
        mixed = self.rows @ white
        own = np.broadcast_to(white.T @ white, (len(self.atoms), white.shape[1], white.shape[1]))
        gram = np.block([[self.gram, mixed], [mixed.transpose(0, 2, 1), own]])
        right = np.concatenate([self.right, self.target @ white], axis=1)
        theta = solve_normal(gram, right)
        gains = theta[:, : self.rows.shape[1]][:, self._gains]
        physical = np.all((gains >= self._low) & (gains <= self._high), axis=1)
        return np.where(physical, self.square - np.sum(right * theta, axis=1), np.inf)

    def beside(self, terms: Terms) -> tuple[Float[np.ndarray, " atoms"], Beside]:
        """What each atom leaves alone, and all terms beside it."""
        basis = eigenbasis(self.gram)  # (atoms, width, width)
        width = self.rows.shape[1]
        flat = self.rows.reshape(-1, self.rows.shape[2]) @ terms.white
        inside = basis.transpose(0, 2, 1) @ flat.reshape(len(self.atoms), width, -1)
        seen = np.einsum("awv,aw->av", basis, self.right)
        along = self.target @ terms.white - np.einsum("avc,av->ac", inside, seen)
        return self.square - np.sum(seen**2, axis=1), terms.left(inside, along)


def changes(atoms: Sequence[CandidateColumns], base: Base, power: Rows) -> list[Changes]:
    """One object for all atoms of each effect."""
    several: dict[object, list[CandidateColumns]] = {}
    for one in atoms:
        several.setdefault(one.placed, []).append(one)
    return [Changes(own, base, power) for own in several.values()]


def _slopes(one: CandidateColumns) -> Float[np.ndarray, "rows np"]:
    assert one.slopes is not None
    return one.slopes


def _target(one: CandidateColumns) -> Rows:
    assert one.target is not None
    return one.target


def _joint(a: np.ndarray, b: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """ρ'R⁻¹ρ of two correlated columns; of twins what the better one takes."""
    left = 1.0 - correlation**2
    joint = (a**2 + b**2 - 2.0 * a * b * correlation) / np.maximum(left, 1e-6)
    return np.where(left > 1e-6, joint, np.maximum(a**2, b**2))
