"""Fast screening of many sets of effects: whitened columns, with the model projected out.

Adding one column to a least-squares problem needs only products of columns. They are formed once
for each power S, for all candidates together; the most promising sets are then fitted exactly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.regression import Base, Rows, eigenbasis, solve_normal

_RANK = 1e-7  # share of its power below which a projected column depends on the model's columns

Columns = Float[np.ndarray, "*batch columns"]


@dataclass(frozen=True)
class Projection:
    """The columns of the terms, with the columns of a model projected out.

    Leading axes: one entry per model.

    Attributes:
        coordinates: the columns in an orthonormal basis of the model's, shape (*, model, columns).
        square: power of each column after projection; 1 where it depends on the model's columns.
        independent: whether a column is independent of those of the model.
        rho: the part of the target's root power that a column explains if only it is added.
    """

    coordinates: Float[np.ndarray, "*batch model columns"]
    square: Columns
    independent: Bool[np.ndarray, "*batch columns"]
    rho: Columns


class Terms:
    """Candidates that add columns to the model."""

    def __init__(self, atoms: Sequence[CandidateColumns], power: Rows):
        self.weight = 1.0 / np.sqrt(power)
        widths = [atom.columns.shape[1] for atom in atoms]
        self.owner = np.repeat(np.arange(len(atoms)), widths)
        self.first = np.concatenate([[0], np.cumsum(widths, dtype=int)])
        stacked = np.concatenate([atom.columns for atom in atoms], axis=1) if atoms else None
        rows = np.zeros((len(power), 0)) if stacked is None else stacked
        self.white = rows * self.weight[:, None]
        self.gram = self.white.T @ self.white

    def part(self, atom: int) -> slice:
        """Columns of one candidate."""
        return slice(self.first[atom], self.first[atom + 1])

    def project(self, columns: Float[np.ndarray, "rows model"], target: Rows) -> Projection:
        """The columns of the terms, with those of a model projected out."""
        matrix = columns * self.weight[:, None]
        length = np.linalg.norm(matrix, axis=0)
        q, _ = np.linalg.qr(matrix / np.where(length > 0, length, 1.0))
        white = target * self.weight
        return self.from_products(q.T @ self.white, self.white.T @ (white - q @ (q.T @ white)))

    def from_products(self, coordinates: np.ndarray, products: np.ndarray) -> Projection:
        """The projection from coordinates in a basis and products with the residual target."""
        power = np.diagonal(self.gram)
        square = power - np.sum(coordinates**2, axis=-2)
        independent = square > _RANK * power
        square = np.where(independent, square, 1.0)
        return Projection(
            coordinates, square, independent, np.where(independent, products / np.sqrt(square), 0.0)
        )

    def by_atom(self, projection: Projection) -> Float[np.ndarray, "*batch atoms"]:
        """Cost that each candidate explains: ρ² of one column, or of two columns jointly."""
        first, width = self.first[:-1], np.diff(self.first)
        explained = projection.rho[..., first] ** 2
        pair = width > 1
        i, k = first[pair], first[pair] + 1
        coordinates, square, rho = projection.coordinates, projection.square, projection.rho
        product = self.gram[i, k] - np.sum(coordinates[..., i] * coordinates[..., k], axis=-2)
        # Divide by each root in turn: the product of small squares would be rounded to zero.
        correlation = product / (np.sqrt(square[..., i]) * np.sqrt(square[..., k]))
        explained[..., pair] = _joint_power(rho[..., i], rho[..., k], correlation)
        return explained

    def pairs(self, projection: Projection, count: int) -> list[tuple[float, int, int]]:
        """Pairs of columns of different candidates that explain most cost, with that cost."""
        scale = np.sqrt(projection.square)
        products = self.gram - projection.coordinates.T @ projection.coordinates
        gain = _joint_power(
            projection.rho[:, None], projection.rho, products / np.outer(scale, scale)
        )
        usable = np.outer(projection.independent, projection.independent) & (
            self.owner[:, None] < self.owner
        )
        gain = np.where(usable, gain, 0.0)
        flat = np.argsort(gain, axis=None)[::-1][:count]
        rows, columns = np.unravel_index(flat, gain.shape)
        return [(float(gain[i, k]), int(i), int(k)) for i, k in zip(rows, columns, strict=True)]


class Changes:
    """Candidates of one width that change the declared part of the model, each in its own way."""

    def __init__(self, atoms: Sequence[CandidateColumns], base: Base, power: Rows):
        weight = 1.0 / np.sqrt(power)
        self.atoms = list(atoms)
        self._gains = slice(len(base.free), None)
        parameters = atoms[0].placed.effect.gains
        self._low = np.array([parameter.lower for parameter in parameters])
        self._high = np.array([parameter.upper for parameter in parameters])
        columns = [
            np.concatenate([_slopes(atom)[:, base.free], atom.columns], axis=1) for atom in atoms
        ]
        self.rows = np.stack(columns).transpose(0, 2, 1) * weight  # (atoms, width, rows)
        self.target = np.stack([_target(atom) for atom in atoms]) * weight
        self.weight = weight
        self.gram = self.rows @ self.rows.transpose(0, 2, 1)
        self.right = np.einsum("awr,ar->aw", self.rows, self.target)
        self.square = np.sum(self.target**2, axis=1)

    def costs(self, columns: Float[np.ndarray, "rows added"]) -> Float[np.ndarray, " atoms"]:
        """Σ |R|²/S of each candidate with added columns; infinite if its gain is not physical."""
        white = columns * self.weight[:, None]
        mixed = self.rows @ white
        added = np.broadcast_to(white.T @ white, (len(self.atoms), white.shape[1], white.shape[1]))
        gram = np.block([[self.gram, mixed], [mixed.transpose(0, 2, 1), added]])
        right = np.concatenate([self.right, self.target @ white], axis=1)
        theta = solve_normal(gram, right)
        gains = theta[:, : self.rows.shape[1]][:, self._gains]
        physical = np.all((gains >= self._low) & (gains <= self._high), axis=1)
        return np.where(physical, self.square - np.sum(right * theta, axis=1), np.inf)

    def project_terms(self, terms: Terms) -> tuple[Float[np.ndarray, " atoms"], Projection]:
        """Cost with each candidate alone, and all terms with its columns projected out."""
        basis = eigenbasis(self.gram)  # (atoms, width, width)
        width = self.rows.shape[1]
        flat = self.rows.reshape(-1, self.rows.shape[2]) @ terms.white
        coordinates = basis.transpose(0, 2, 1) @ flat.reshape(len(self.atoms), width, -1)
        target_coordinates = np.einsum("awv,aw->av", basis, self.right)
        products = self.target @ terms.white - np.einsum(
            "avc,av->ac", coordinates, target_coordinates
        )
        return self.square - np.sum(target_coordinates**2, axis=1), terms.from_products(
            coordinates, products
        )


def changes(atoms: Sequence[CandidateColumns], base: Base, power: Rows) -> list[Changes]:
    """One object for all candidates of each effect."""
    by_effect: dict[object, list[CandidateColumns]] = {}
    for atom in atoms:
        by_effect.setdefault(atom.placed, []).append(atom)
    return [Changes(group, base, power) for group in by_effect.values()]


def _slopes(atom: CandidateColumns) -> Float[np.ndarray, "rows np"]:
    assert atom.slopes is not None
    return atom.slopes


def _target(atom: CandidateColumns) -> Rows:
    assert atom.target is not None
    return atom.target


def _joint_power(a: np.ndarray, b: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """ρ'R⁻¹ρ of two correlated columns; for collinear ones the larger of the two ρ²."""
    unique = 1.0 - correlation**2
    joint = (a**2 + b**2 - 2.0 * a * b * correlation) / np.maximum(unique, 1e-6)
    return np.where(unique > 1e-6, joint, np.maximum(a**2, b**2))
