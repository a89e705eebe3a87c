"""Several targets read together: the joint region of their errors around the estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.core import CircularReading, Float, InputError, Reading, VectorReading, split_column
from palpate.core.reading import Ellipsoid, provenance
from palpate.estimators.joint_reach import joint_reach
from palpate.estimators.model_card import InstrumentCard, VectorCard


def mahalanobis(
    scaled: Float[np.ndarray, "n k"], correlation: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Return distances sqrt(rᵀ S⁻¹ r) of errors r in units of their spread.

    P. C. Mahalanobis, Proc. Natl. Inst. Sci. India 2, 49 (1936); as a conformal score: C. Johnstone and B.
    Cox, Proc. Mach. Learn. Res. 152, 72 (2021).
    """
    solved = np.linalg.solve(correlation, scaled.T).T
    return np.sqrt(np.maximum(np.sum(scaled * solved, axis=1), 0.0))


def vector_reading(
    vector: VectorCard,
    parts: Sequence[Reading | CircularReading | VectorReading],
    spread: Float[np.ndarray, " k"] | None,
    measured_by: Sequence[InstrumentCard | None] = (),
) -> VectorReading:
    """Return the vector of some readings, with its joint region.

    Args:
        vector: Card of the vector.
        parts: Readings of its components, in SI.
        spread: Expected error size of each, in the targets' unit; None if nothing was read.
        measured_by: Instruments of the labels, whose uncertainty the region includes.
    """
    quantity, unit = split_column(vector.column)
    sizes = np.ones(len(parts)) if spread is None else unit.to_si(spread)
    covariance = np.array(vector.correlation) * np.outer(sizes, sizes)
    for k, instrument in enumerate(measured_by):
        if instrument is not None and instrument.standard_uncertainty > 0:
            reach = joint_reach(len(parts), parts[0].coverage)  # of all of them: more than that of one
            covariance[k, k] += (reach * unit.to_si(instrument.standard_uncertainty) / vector.radius) ** 2
    whys = dict.fromkeys(part.why for part in parts if part.why)
    codes = dict.fromkeys(part.code for part in parts if part.code)
    first = provenance(parts[0]) | {"valid": not whys, "why": "; ".join(whys), "code": "; ".join(codes)}
    ranges = [part.calibrated_range for part in parts if isinstance(part, Reading)]
    return VectorReading(
        quantity=quantity,
        components=vector.components,
        value=np.array([part.value for part in parts if isinstance(part, Reading)]),
        region=Ellipsoid((covariance + covariance.T) / 2, vector.radius),
        calibrated_range=np.array(ranges).T,
        **first,
    )


def component_names(name: str, parts: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a vector's components: what follows the vector's own name, or their whole quantity.

    Example:
        >>> component_names("force_N", ("force_x_N", "force_y_N"))
        ('x', 'y')
    """
    own = f"{split_column(name)[0]}_"
    return tuple(split_column(part)[0].removeprefix(own) for part in parts)


def vector_column(name: str, parts: Sequence[str], targets: Sequence[str]) -> str:
    """Return a vector's column: its name, such as ``force``, with the common unit of its components."""
    if not name:
        raise InputError(
            f"a vector of {', '.join(parts)} has no name; give it one, such as force", code="vector-name"
        )
    if len(parts) < 2 or len(set(parts)) < len(parts):
        raise InputError(
            f"vector {name}: {', '.join(parts)}; it has two components or more, each once", code="vector-size"
        )
    if strangers := [part for part in parts if part not in targets]:
        raise InputError(
            f"vector {name}: {', '.join(strangers)} are not among the targets, {', '.join(targets)}",
            code="no-target",
        )
    units = {split_column(part)[1].symbol for part in parts}
    if len(units) > 1:
        raise InputError(
            f"vector {name}: its components are in {', '.join(sorted(units))}; a vector has one unit",
            code="vector-units",
        )
    (symbol,) = units
    column = name if name.endswith(f"_{symbol}") else f"{name}_{symbol}"
    if column in targets:
        raise InputError(
            f"vector {name}: {column} is a target already; give the vector a name of its own",
            code="name-taken",
        )
    return column
