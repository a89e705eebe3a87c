"""Every step from a camera's pixels to a reading, in words and numbers, for independent readers.

A test runs the reader on the page `read-without-palpate.md` against the package. Changed steps need another
rule.

The reach of errors together: how far several independent normal ones go, beside one alone.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from palpate.estimators.card_ground import CardPart

if TYPE_CHECKING:
    from palpate.estimators.model_card import Card, CircularCard, InputCard, TargetCard


@cache
def joint_reach(components: int, coverage: float) -> float:
    """Return the radius of the ball that holds several standard normal errors with a coverage.

    It is the quantile of the chi distribution (JCGM 102:2011, doi:10.59161/JCGM102-2011).

    Example:
        >>> [round(joint_reach(k, 0.9), 4) for k in (1, 2, 3)]
        [1.6449, 2.146, 2.5003]
    """
    from scipy.special import chdtri  # here, since few cards need it, and sensing starts without scipy

    return float(chdtri(components, 1 - coverage)) ** 0.5


RULE, RULE_OF_INSTRUMENTS, RULE_OF_LENSES = "palpate-steps/1", "palpate-steps/2", "palpate-steps/3"
"""The second is that of cards whose labels' instruments widen readings: of such, the first joined the
instrument to a vector's region as to a single interval, and judged an interval's length without it."""
GREY_WEIGHTS, GREY_ROUNDING, GREY_SHIFT = (9798, 19235, 3735), 16384, 15
"""Red, green and blue's parts of grey in 1/32768: ITU-R BT.601's 0.299, 0.587 and 0.114, as OpenCV rounds
them."""
SMALLER, LARGER = "INTER_AREA", "INTER_LINEAR"
CLIP = 3.0
MIN_SPREAD, MAX_SPREAD = 0.2, 5.0


class StepsCard(CardPart):
    """Steps from a camera's pixels to a reading.

    Attributes:
        rule: Version of the steps; readers refuse unknown ones.
        grey_weights, grey_rounding, grey_shift: (weights . (red, green, blue) + rounding) >> shift is gray.
        smaller, larger: OpenCV interpolation if no side grows, and if one does.
        clip: Bound of the scaled outputs in the spread's terms.
        min_spread, max_spread: Bounds of the spread in units of `TargetCard.typical`.
        words: Steps as sentences, in order.
    """

    rule: str
    grey_weights: tuple[int, int, int]
    grey_rounding: int
    grey_shift: int
    smaller: str
    larger: str
    clip: float
    min_spread: float
    max_spread: float
    words: tuple[str, ...]


def reading_steps(card: Card) -> StepsCard:
    """Return the steps by which a card's readings are made, as numbers and sentences."""
    return StepsCard(
        rule=_rule(card),
        grey_weights=GREY_WEIGHTS,
        grey_rounding=GREY_ROUNDING,
        grey_shift=GREY_SHIFT,
        smaller=SMALLER,
        larger=LARGER,
        clip=CLIP,
        min_spread=MIN_SPREAD,
        max_spread=MAX_SPREAD,
        words=(*_picture(card.input), *_network(card), *_interval(card), *_verdict(card), *_refusals(card)),
    )


def _rule(card: Card) -> str:
    """Rule of the steps; with a lens it differs, so that readers without one refuse the card."""
    if card.input.lens is not None:
        return RULE_OF_LENSES
    return RULE_OF_INSTRUMENTS if _measured(card) else RULE


def _picture(given: InputCard) -> tuple[str, ...]:
    height, width = given.frame_px
    boxes = [box for box in (given.crop_px, given.beside_px) if box is not None]
    frame = (
        f"Take a frame of {width} x {height} px, 8 bits a channel, grey or red, green, blue in this order, "
        "the rows from the top; a frame of another size is not read."
    )
    places = " and ".join(f"columns {x} to {x + w - 1}, rows {y} to {y + h - 1}" for x, y, w, h in boxes)
    cut = (f"Cut out {places}, counted from 0 at the top left.",) if boxes else ()
    return (frame, *_lens(given), *cut, _channels(given), _scaling(given, boxes or [(0, 0, width, height)]))


def _lens(given: InputCard) -> tuple[str, ...]:
    if given.lens is None:
        return ()
    (fx, fy), (cx, cy) = given.lens.focal_px, given.lens.centre_px
    if given.lens.model == "kannala-brandt":
        k1, k2, k3, k4 = given.lens.distortion
        bent = (
            f"t = atan(hypot(u, v)), at ({cx!r} + {fx!r} s u, {cy!r} + {fy!r} s v), where "
            f"s = t (1 + {k1!r} t^2 + {k2!r} t^4 + {k3!r} t^6 + {k4!r} t^8) / hypot(u, v)"
        )
    else:
        k1, k2, p1, p2, k3 = given.lens.distortion
        bent = (
            f"q = u^2 + v^2, s = 1 + {k1!r} q + {k2!r} q^2 + {k3!r} q^3, at "
            f"({cx!r} + {fx!r} (s u + 2 ({p1!r}) u v + "
            f"{p2!r} (q + 2 u^2)), {cy!r} + {fy!r} (s v + {p1!r} (q + 2 v^2) + 2 ({p2!r}) u v))"
        )
    sentence = (
        f"Take out the bending of lens {given.lens.id}: pixel (x, y) of the new image, of the same size, "
        f"with u = (x - {cx!r}) / {fx!r}, v = (y - {cy!r}) / {fy!r}, is the old one's with {bent}; as 32-bit "
        "floats, by OpenCV's convertMaps to CV_16SC2 and remap, linear; black outside the old image and "
        f"where atan(hypot(u, v)) is beyond {given.lens.field_rad!r}."
    )
    return (sentence,)


def _channels(given: InputCard) -> str:
    if given.channels == 3:
        return "Keep the three channels; of a grey frame each of them is its grey."
    red, green, blue = GREY_WEIGHTS
    return (
        f"Make colour grey by ITU-R BT.601 in whole numbers: ({red} red + {green} green + {blue} blue + "
        f"{GREY_ROUNDING}) >> {GREY_SHIFT}; a grey frame stays as it is."
    )


def _scaling(given: InputCard, boxes: list[tuple[int, int, int, int]]) -> str:
    height, width = given.size_px[0], given.size_px[1] // len(boxes)
    ways = " or ".join(sorted({_way(w, h, width, height) for _, _, w, h in boxes}))
    if len(boxes) == 1:
        return f"Bring it to {width} x {height} px, {ways}."
    return f"Bring each part to {width} x {height} px, {ways}, and lay the second to the right of the first."


def _way(w: int, h: int, width: int, height: int) -> str:
    if (w, h) == (width, height):
        return "which it has already"
    if width <= w and height <= h:
        return f"by OpenCV's {SMALLER}: each pixel is the mean of the area that it covers, rounded"
    return f"by OpenCV's {LARGER}, linear interpolation, since a side grows"


def _network(card: Card) -> tuple[str, ...]:
    given = card.input
    shape = f"[1, {given.channels}, {given.size_px[0]}, {given.size_px[1]}]"
    numbers = "Take the grey levels as they are, 0 to 255, as 32-bit floating point numbers"
    less = ", less those of an image of the untouched sensor, brought to this form in the same way"
    outputs = [name for target in card.targets for name in _outputs_of(target)]
    outputs += [f"the output for {name} of {one.column}" for one in card.classes or () for name in one.names]
    network = (
        f"Give them to {card.model.file} (ONNX) as its input `image`, {shape}: one frame, channels, rows, "
        f"columns. Its output `value` has {len(outputs)} numbers: {', '.join(outputs)}."
    )
    circular = tuple(
        f"The estimate of {target.column} is atan2(sine, cosine) times {_digits(target.period)} / (2 pi), "
        f"above -{_digits(target.period / 2)} and up to {_digits(target.period / 2)} {target.unit}; it comes "
        f"round again after {_digits(target.period)} {target.unit}."
        for target in card.targets
        if target.period is not None
    )
    return (f"{numbers}{less if given.delta else ''}.", network, *circular)


def _digits(number: float) -> str:
    """All digits of a number."""
    return repr(float(number)).removesuffix(".0")


def _outputs_of(target: TargetCard) -> tuple[str, ...]:
    if target.circular is None:
        return (f"the estimate of {target.column} in {target.unit}",)
    return (f"the cosine of {target.column}", f"its sine ({target.column})")


def _interval(card: Card) -> tuple[str, ...]:
    if not card.targets:
        return ()
    circular = any(target.circular is not None for target in card.targets)
    scale = (
        ", each with its own centre and scale (a cosine and a sine with the pairs in `circular`)"
        if circular
        else ""
    )
    terms = (
        f"For each of the targets' outputs take s = (output - centre) / scale{scale}, held between -{CLIP:g} "
        f"and {CLIP:g}; for all the targets' outputs together the terms 1, then each s, then each product "
        "s_i s_j with i <= j, in the order 11, 12, ..., 22, 23, ...."
    )
    spread = (
        "The spread of a target is typical times exp(coefficients . terms), where the exponential is held "
        f"between {MIN_SPREAD:g} and {MAX_SPREAD:g}."
    )
    interval = (
        "Half is quantile times the spread. The interval reaches from estimate - half to estimate + half, "
        f"and is made to hold the truth in {100 * card.coverage:g} % of readings."
    )
    banded = [target.column for target in card.targets if _has_bands(target)]
    return (terms, spread, interval, *_bands(banded))


def _has_bands(target: TargetCard) -> bool:
    over = target.over_range
    return over is not None and over.by_truth is not None and over.by_estimate is not None


def _bands(columns: list[str]) -> tuple[str, ...]:
    if not columns:
        return ()
    named = ", ".join(columns)
    truths = (
        f"The interval of {named} is lengthened to cover every part of the range. `by_truth` of over_range "
        "divides the range at its limits into cells. Of each cell whose half is above 0 take estimate + "
        "spread (centre - half) to estimate + spread (centre + half), cut to the cell, the outermost cells "
        "having no end; what is left of it, if anything, belongs to the interval."
    )
    estimates = (
        "Of `by_estimate` of over_range take the one cell that the estimate lies in (a limit belongs to the "
        "cell above it); where its half is above 0, the same piece, not cut, belongs to the interval. The "
        "interval's ends are the least and the greatest of all these, so that it need not lie evenly around "
        "the estimate."
    )
    return (truths, estimates)


def _verdict(card: Card) -> tuple[str, ...]:
    plain = [t for t in card.targets if t.circular is None and t.over_range is not None]
    before = [t for t in card.targets if t.circular is None and t.over_range is None]
    said: list[str] = []
    if plain:
        said.append(
            f"A reading of {_named(plain)} is not valid where its interval is as long as the calibrated "
            "range, greatest - least, or longer."
        )
        said.append(
            "Nor is it where it is extrapolated, by the pairs `beyond` and `reach` of over_range (below, "
            "above): where the estimate lies below least, or above greatest, by more than beyond; or where "
            "the interval reaches below least, or above greatest, by more than reach."
        )
    if before:
        said.append(
            f"A reading of {_named(before)} is not valid where the whole interval lies beyond least to "
            "greatest: estimate < least - half or estimate > greatest + half."
        )
    said += [_verdict_of_angle(target, target.circular) for target in card.targets if target.circular]
    return (*_unread(card), *said, *_reference(card), *_vectors(card), *_classes(card))


def _unread(card: Card) -> tuple[str, ...]:
    """Rule for targets that are not read, and their names."""
    ruled = [target for target in card.targets if target.has_range_rule]
    if not ruled:
        return ()
    unread = _named([target for target in ruled if not target.is_read])
    rule = (
        f"No reading of {_named(ruled)} is valid where the calibration does not read it: where `mae` of its "
        "score is above 0.95 times `mean_mae`, or where twice `half_width` of its score is as long as the "
        "calibrated range, greatest - least (of a target that comes round again, its `untold_width`, or the "
        f"period where it has none), or longer. Of this card that is {unread or 'none'}."
    )
    return (rule,)


def _verdict_of_angle(target: TargetCard, circular: CircularCard) -> str:
    if circular.untold_width == 0:
        return (
            f"No reading of {target.column} is valid (its `untold_width` is 0): on rows held out, it told no "
            "more than always saying the mean."
        )
    long = (
        "as long as the period"
        if circular.untold_width is None
        else f"{_digits(circular.untold_width)} {target.unit} long (its `untold_width`) or longer"
    )
    return (
        f"A reading of {target.column} is not valid where its interval is {long}, or where the estimate lies "
        "outside the arc from least to greatest, the shorter way round, by more than half."
    )


def _classes(card: Card) -> tuple[str, ...]:
    return tuple(
        f"The prediction set of {one.column} holds each class whose output reaches its own number in "
        "`thresholds` of classes, and each class that has none there (null); the value is the class with the "
        "greatest output, and it is not valid where the set is empty, holds every class or does not hold it."
        for one in card.classes or ()
    )


def _named(targets: list[TargetCard]) -> str:
    return ", ".join(target.column for target in targets)


def _measured(card: Card) -> list[TargetCard]:
    """Targets whose instrument widens their intervals."""
    return [t for t in card.targets if t.measured_by is not None and t.measured_by.half_width > 0]


def _reference(card: Card) -> tuple[str, ...]:
    measured = _measured(card)
    if not measured:
        return ()
    last = (
        f"Last, each side of the interval of {_named(measured)} becomes the root of its square plus the "
        "square of `half_width` of measured_by, which is what the labels' own instrument leaves open; the "
        "rule of its length is for this interval, those of where it lies were for the interval before."
    )
    return (last,)


def _vectors(card: Card) -> tuple[str, ...]:
    return tuple(
        f"{v.column} is {', '.join(v.columns)} together. Its region holds the differences d for which "
        "d . inverse(C) d <= radius squared, where C is correlation_ij times spread_i spread_j"
        f"{_with_instruments(card, v.columns)}; it is valid where all of them are."
        for v in card.vectors or ()
    )


def _with_instruments(card: Card, columns: tuple[str, ...]) -> str:
    if not any(target.column in columns for target in _measured(card)):
        return ""
    reach = joint_reach(len(columns), card.coverage)
    return (
        f", and ({reach:.6g} standard_uncertainty / radius) squared more on its diagonal, with that of "
        "measured_by where there is one"
    )


def _refusals(card: Card) -> tuple[str, ...]:
    guard = (
        f"No reading is valid where the frame is unlike those calibrated on. {card.guard.file} judges that, "
        "and palpate reads it: by the distance of the frame's thumbnail from those calibrated on, beside "
        "what is usual among them, and, where changes of the camera were tried, by what the changes that "
        "the frame looks most like cost this model. A program without that check does not know when a "
        "picture is not to be trusted."
    )
    copy = (
        f"Nor where the frame looks like one of {card.copy_of.former} rather than of {card.copy_of.name}, "
        f"which {card.copy_of.file.file} tells apart."
        if card.copy_of is not None and card.copy_of.file is not None
        else ""
    )
    return (guard, copy) if copy else (guard,)
