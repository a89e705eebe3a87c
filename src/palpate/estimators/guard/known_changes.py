"""Known changes: frames changed on purpose, the wrong readings that they cause, and what to refuse.

A new frame is placed among the examples along directions in which changes differ from touches (Fisher's
discriminant, doi:10.1111/j.1469-1809.1936.tb02137.x); its nearest ones predict the harm (Stone, Ann. Stat.
5:595 (1977), doi:10.1214/aos/1176343886). Far from all examples the thumbnail's own limit holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from palpate.core import Bool, Float, Float32, Indices, Int, Shaped
from palpate.estimators.guard.guard_features import LOCAL_FEATURES, Registration

Thumbnail = Float32[np.ndarray, "h w c"]

FLIPPED = "flipped"
# kinds of flip, and the code by which `cv2.flip` takes each back
FLIPS: Mapping[str, int] = {"mirrored-x": 1, "mirrored-y": 0, "rotated-180": -1}
# words for each kind, and for several that fit alike
MIRRORED: Mapping[str, str] = {
    "mirrored-x": "mirrored, left for right",
    "mirrored-y": "mirrored, upside down",
    "rotated-180": "turned by half a turn",
    FLIPPED: "mirrored or turned by half a turn",
}
# greatest novelty ratio of the best to the second-best flip that identifies the flip
MAX_SECOND = 0.5
# greatest ratio of the median deviation from the reference, flipped back over as it is
MAX_FLIPPED_BACK = 0.5
MIN_AWAY_GREY_LEVELS = 2.0  # least deviation; below, the picture fits the reference as it is


def flipped(picture: Thumbnail, code: int) -> Thumbnail:
    """Return a picture flipped as `cv2.flip` does: 0 vertically, 1 horizontally, -1 both."""
    rows, columns = (slice(None, None, -1 if code in codes else 1) for codes in ((0, -1), (1, -1)))
    return np.ascontiguousarray(picture[rows, columns])


def unflipped(picture: Thumbnail, untouched: Thumbnail) -> dict[str, Thumbnail]:
    """Return the picture flipped back by each flip that explains its change [gray levels].

    A flip must fit the no-contact part of the frame; a touch elsewhere on a symmetric sensor could resemble
    one.
    """
    away = float(np.median(np.abs(picture - untouched)))
    back = {kind: flipped(picture, code) for kind, code in FLIPS.items()}
    most = MAX_FLIPPED_BACK * away if away >= MIN_AWAY_GREY_LEVELS else -1.0
    return {kind: one for kind, one in back.items() if np.median(np.abs(one - untouched)) <= most}


def told_flip(novelty: Mapping[str, float]) -> str:
    """Return the kind of flip by the relative novelty of the picture flipped back by each, or ""."""
    fit = sorted((value, kind) for kind, value in novelty.items() if value <= 1.0)
    if not fit:
        return ""
    told = len(fit) == 1 or fit[0][0] <= MAX_SECOND * fit[1][0]
    return fit[0][1] if told else FLIPPED


# greatest rise of the ratio of readings beyond twice their half-width
MAX_HARM = 0.01
MAX_FALSE_REFUSALS = 0.03  # ratio of unchanged frames that may be rejected
NEIGHBOURS = 12
DIRECTIONS = 16
THIRD = 2  # index of the third nearest example, whose distance is used
KNOWN_SHARE = 0.97  # of examples count as near to the others
HARMLESS_SHARE = 0.9  # quantile of harmless novelty that is tolerated
MIN_FEATURE_SPREAD = 0.01
MIN_VARIANCE = 0.01  # of an axis of the unchanged frames, whose mean variance is about 1
LINEAR_SPREADS = 3.0  # within which features count in proportion; beyond, by their logarithm


@dataclass(frozen=True, slots=True)
class Signature:
    """Name and remedy of a kind of change."""

    words: str
    remedy: str


EXCHANGED = "exchanged channels"  # see `novelty.channels_exchanged`

# words for each kind, by the names of `calibration.robustness.KINDS`
SIGNATURES: Mapping[str, Signature] = {
    "focus": Signature("a lens out of focus", "refocus the camera"),
    "softening": Signature(
        "pictures softened by a codec or a resize", "store and scale frames as those of the calibration"
    ),
    "shift": Signature("a camera or skin that has shifted", "seat it again and take a new zero, or adapt"),
    "turn": Signature("a camera or skin that has turned", "seat it again and take a new zero, or adapt"),
    "zoom": Signature("a camera nearer or farther", "seat it again and take a new zero, or adapt"),
    "brightness": Signature("another brightness", "set light and exposure as they were"),
    "colour": Signature("another order of colours or gamma", "set colours and gamma as they were"),
    "marker width": Signature("another threshold or exposure", "set exposure and threshold as they were"),
    "compression": Signature("stronger compression", "store frames as those of the calibration"),
    "noise": Signature("noise", "give more light, or less gain"),
    "dust": Signature("dust", "clean lens and skin"),
    "dead columns": Signature("dead columns of the camera", "exchange the camera"),
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """Judgment of a frame.

    Attributes:
        atypicality: Above 1 the frame is refused.
        kind: Change that it resembles, a name in `SIGNATURES` or `MIRRORED`, or `EXCHANGED`; "" for none.
        known: Whether it is as near to known examples as they are to each other.
        costs: Whether it was refused for the harm of such a change.
    """

    atypicality: float
    kind: str = ""
    known: bool = False
    costs: bool = False

    @property
    def reason(self) -> str:
        """Reason of a refusal, and the remedy, in words."""
        if self.kind == EXCHANGED:
            return (
                "red and blue seem exchanged: the image has the colours of those calibrated on, with blue "
                "where they have red; give red, green, blue, of OpenCV's frames by cv2.COLOR_BGR2RGB"
            )
        unlike = f"the image is unlike those calibrated on (distance {self.atypicality:.1f}, limit 1)"
        if self.kind in MIRRORED:
            by = f", or by cv2.flip(image, {FLIPS[self.kind]})" if self.kind in FLIPS else ""
            return (
                f"{unlike}; it seems {MIRRORED[self.kind]}: flipped back it is like them, and what is bare "
                f"in it is the untouched sensor; give frames as they were calibrated on{by}"
            )
        if self.kind not in SIGNATURES:
            return unlike
        sign = SIGNATURES[self.kind]
        cost = ", by which this model errs more than its intervals allow" if self.costs else ""
        if not self.known:
            return (
                f"{unlike}, nor like any change that was tried; the nearest of those is {sign.words}{cost}: "
                f"{sign.remedy}; where that is not it, adapt or calibrate again"
            )
        other = "calibrate with such frames" if self.costs else "adapt"
        return f"{unlike}; it looks like {sign.words}{cost}: {sign.remedy}, or {other}"


@dataclass(frozen=True)
class ChangeExamples:
    """Frames of a calibration, unchanged and changed.

    Attributes:
        features: ``[m k]``, see `guard_features.frame_features`.
        frame: Frame number; examples of one frame are never each other's neighbors.
        kind: Number of its kind among `names`, from 1; 0 if unchanged.
        harm: Rise of the ratio of readings beyond twice their half-width.
        novelty: Novelty of the thumbnail over its limit.
        local: Whether features include those of the thumbnail less its reconstruction.
    """

    features: Float[np.ndarray, "m k"]
    frame: Int[np.ndarray, " m"]
    kind: Int[np.ndarray, " m"]
    harm: Float[np.ndarray, " m"]
    novelty: Float[np.ndarray, " m"]
    names: tuple[str, ...]
    local: bool = False

    def only(self, chosen: Bool[np.ndarray, " m"]) -> ChangeExamples:
        return ChangeExamples(
            self.features[chosen],
            self.frame[chosen],
            self.kind[chosen],
            self.harm[chosen],
            self.novelty[chosen],
            self.names,
            self.local,
        )

    def without_local(self) -> ChangeExamples:
        """Return the examples without the local features."""
        if not self.local:
            return self
        return replace(self, features=self.features[:, :-LOCAL_FEATURES], local=False)


@dataclass(frozen=True)
class KnownChanges:
    """Examples of changes, positioned for comparison.

    Attributes:
        centre, spread, axes: Map from features to positions ``[k]``, ``[k]``, ``[k d]``.
        places: Positions of the examples ``[m d]``.
        spacing: Distance of the third nearest example of another frame ``[m]``.
        limits: Limits of harm, spacing ratio, and novelty among known changes, and the common divisor.
    """

    registration: Registration
    centre: Float32[np.ndarray, " k"]
    spread: Float32[np.ndarray, " k"]
    axes: Float32[np.ndarray, "k d"]
    places: Float32[np.ndarray, "m d"]
    spacing: Float32[np.ndarray, " m"]
    harm: Float32[np.ndarray, " m"]
    novelty: Float32[np.ndarray, " m"]
    kind: Int[np.ndarray, " m"]
    names: Shaped[np.ndarray, " q"]
    limits: Float[np.ndarray, " 4"]
    local: bool = False

    def judge(self, features: Float[np.ndarray, " k"], novelty: float) -> Verdict:
        """Judge a frame by its features and by its thumbnail's novelty over the limit."""
        at = _places(features, self.centre, self.spread, self.axes)
        away = self.places - at
        square = np.einsum("md,md->m", away, away)
        count = min(NEIGHBOURS, len(square))
        near = square.argpartition(count - 1)[:count]
        near = near[square[near].argsort()]
        weight = 1 / (square[near] + 1)
        max_harm, max_ratio, max_novelty, scale = self.limits
        harm = float(weight @ self.harm[near] / weight.sum()) / max_harm
        ratio = _ratio(float(np.sqrt(square[near[min(THIRD, len(near) - 1)]])), self.spacing[near])
        known = bool(ratio <= max_ratio)
        tolerated = max(float(max_novelty), float(self.novelty[near].max())) if known else 1.0
        atypicality = max(harm, novelty / tolerated) / scale
        costs = bool(harm >= novelty / tolerated)
        votes = np.bincount(
            self.kind[near], weight * (self.harm[near] if costs else 1.0), len(self.names) + 1
        )
        votes[0] = 0.0
        best = int(np.argmax(votes))
        return Verdict(float(atypicality), str(self.names[best - 1]) if votes[best] else "", known, costs)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all parts as plain arrays with prefixed names."""
        own = {name: getattr(self, name) for name in OWN_ARRAYS}
        if self.local:
            own["local"] = np.array(True)
        parts = {f"registration_{f.name}": getattr(self.registration, f.name) for f in fields(Registration)}
        return {PREFIX + name: part for name, part in (own | parts).items()}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> KnownChanges | None:
        """Return the inverse of `arrays`; None if they hold no known changes."""
        if PREFIX + "places" not in arrays:
            return None
        own = {name: arrays[PREFIX + name] for name in OWN_ARRAYS}
        parts = {f.name: arrays[f"{PREFIX}registration_{f.name}"] for f in fields(Registration)}
        _refuse_unfit(own, parts)
        return cls(registration=Registration(**parts), **own, local=PREFIX + "local" in arrays)


def _refuse_unfit(own: Mapping[str, np.ndarray], registration: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays that are not those of one `KnownChanges` (ValueError)."""
    k, d = own["axes"].shape if own["axes"].ndim == 2 else (0, 0)
    m, p, q = len(own["harm"]), len(registration["mean"]), len(own["names"])
    wanted = {
        "centre": (k,), "spread": (k,), "axes": (k, d), "places": (m, d), "spacing": (m,), "harm": (m,),
        "novelty": (m,), "kind": (m,), "names": (q,), "limits": (4,),
    }  # fmt: skip
    wanted_of = {"mean": (p,), "jacobian": (p, 7), "inverse": (7, p), "weight": (p,)}
    fit = m * k * d * p * q > 0 and own["names"].dtype.kind == "U"
    for parts, shapes in ((own, wanted), (registration, wanted_of)):
        fit = fit and all(parts[name].shape == shape for name, shape in shapes.items())
    numbers = [part for name, part in (*own.items(), *registration.items()) if name not in ("names", "kind")]
    fit = fit and all(part.dtype.kind == "f" and bool(np.isfinite(part).all()) for part in numbers)
    if not fit or own["kind"].dtype.kind != "i" or not 0 <= own["kind"].min() <= own["kind"].max() <= q:
        raise ValueError("its known changes do not fit each other")
    if min(*own["limits"], *own["spread"]) <= 0:
        raise ValueError("its limits of known changes are not above 0")


PREFIX = "known_"
OWN_ARRAYS = tuple(f.name for f in fields(KnownChanges) if f.name not in ("registration", "local"))


def _places(features: np.ndarray, centre: np.ndarray, spread: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Features along the axes, linear within a few spreads and logarithmic beyond."""
    scaled = (features - centre) / (LINEAR_SPREADS * spread)
    return np.asarray(LINEAR_SPREADS * np.arcsinh(scaled) @ axes, dtype=np.float32)


def _ratio(away: float, spacing: np.ndarray) -> float:
    """Distance over the usual one nearby, each plus the unit scatter of unchanged frames."""
    return (away + 1.0) / (float(spacing.mean()) + 1.0)


def fit_known_changes(examples: ChangeExamples, registration: Registration) -> KnownChanges:
    """Position the examples, and set the limits of nearness and of harmless novelty."""
    unchanged = examples.kind == 0
    centre = examples.features[unchanged].mean(axis=0).astype(np.float32)
    spread = np.maximum(examples.features[unchanged].std(axis=0), MIN_FEATURE_SPREAD).astype(np.float32)
    axes = _axes(_places(examples.features, centre, spread, np.eye(len(centre))), examples)
    places = _places(examples.features, centre, spread, axes)
    spacing, ratio = _spacing(places, examples.frame)
    harmless = examples.novelty[~unchanged & (examples.harm <= MAX_HARM)]
    tolerated = max(1.0, float(np.quantile(harmless, HARMLESS_SHARE))) if len(harmless) else 1.0
    return KnownChanges(
        registration,
        centre,
        spread,
        axes,
        places,
        spacing,
        examples.harm.astype(np.float32),
        examples.novelty.astype(np.float32),
        examples.kind.astype(np.int64),
        np.array(examples.names, dtype=np.str_),
        np.array([MAX_HARM, np.quantile(ratio, KNOWN_SHARE), tolerated, 1.0]),
        examples.local,
    )


def _axes(scaled: Float32[np.ndarray, "m k"], examples: ChangeExamples) -> Float32[np.ndarray, "k d"]:
    """Directions in which changes move features most, relative to the unchanged frames' scatter."""
    # Here, since whoever senses needs no scikit-learn.
    from sklearn.covariance import LedoitWolf

    unchanged = examples.kind == 0
    variance, vectors = np.linalg.eigh(LedoitWolf().fit(scaled[unchanged]).covariance_)
    whitening = vectors / np.sqrt(np.maximum(variance, MIN_VARIANCE))
    own = dict(zip(examples.frame[unchanged].tolist(), np.flatnonzero(unchanged).tolist(), strict=True))
    origin = [own[frame] for frame in examples.frame[~unchanged].tolist()]
    moved = (scaled[~unchanged] - scaled[origin]) @ whitening
    # A change that is 20 units away counts no more than that: how far is known well enough there.
    moved /= np.maximum(1.0, np.linalg.norm(moved, axis=1, keepdims=True) / 20)
    _, _, directions = np.linalg.svd(moved, full_matrices=False)
    return np.asarray(whitening @ directions[:DIRECTIONS].T, dtype=np.float32)


def _spacing(places: np.ndarray, frame: np.ndarray) -> tuple[Float32[np.ndarray, " m"], np.ndarray]:
    """Distance of each example's third neighbor of another frame, and its ratio to those nearby."""
    spacing, near = np.empty(len(places), np.float32), []
    for i, at in enumerate(places):
        away = np.sqrt(np.sum((places - at) ** 2, axis=1))
        away[frame == frame[i]] = np.inf
        nearest = np.argsort(away)[:NEIGHBOURS]
        nearest = nearest[np.isfinite(away[nearest])]
        near.append(nearest)
        spacing[i] = away[nearest[min(THIRD, len(nearest) - 1)]]
    return spacing, np.array([_ratio(float(spacing[i]), spacing[rows]) for i, rows in enumerate(near)])


def cross_fitted(
    examples: ChangeExamples, registration: Registration, folds: Sequence[Indices]
) -> list[Verdict]:
    """Return the verdict on every example by known changes trained on frames of other folds."""
    verdicts = [Verdict(np.inf)] * len(examples.frame)
    for fold in folds:
        held = np.isin(examples.frame, fold)
        if not held.any():
            continue
        known = fit_known_changes(examples.only(~held), registration)
        for i in np.flatnonzero(held):
            verdicts[i] = known.judge(examples.features[i], float(examples.novelty[i]))
    return verdicts


def rescaled(known: KnownChanges, unchanged: Float[np.ndarray, " n"]) -> tuple[KnownChanges, float]:
    """Return the same with limits that pass the allowed ratio of unchanged frames, and the factor."""
    beyond = float(np.quantile(unchanged, 1 - MAX_FALSE_REFUSALS, method="higher"))
    factor = max(1.0, beyond)
    return replace(known, limits=known.limits * np.array([1.0, 1.0, 1.0, factor])), factor
