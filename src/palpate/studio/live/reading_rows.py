"""Rows of readings on a page: each value in plain words with its interval, and below them the reasons.

Every row is one line high whatever it says, and reasons have a room of their own: a page whose lines move as
frames come cannot be read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

from palpate.core import half_width_text, rounded
from palpate.studio.status_text import number

Told = Mapping[str, Any]
"""A reading as its process tells it, in plain values."""

GAMMA = (
    "how far the skin's pattern has moved on average, scaled as published for the NUSense: near 0 where "
    "nothing touches, and greater the harder it is pressed; it is no force"
)
NAMES = {
    "gamma": ("touch measure γ", GAMMA),
    "seen": (
        "marks seen",
        "share of the skin's marks that this frame shows; counted, and so without an interval",
    ),
    "contacts": ("contacts", "how many things touch the skin"),
    "edge": ("edge's direction", "direction of an edge that is pressed; a round contact has none"),
    "shift_x": ("shift along x", "how far the skin's pattern has moved under the first contact"),
    "shift_y": ("shift along y", "how far the skin's pattern has moved under the first contact"),
    "slip": ("slip", "whether the contact slides over the skin"),
    "damage": ("damage", "whether the skin looks torn"),
}
"""Plain words for readings, and what each is, by its quantity; others have their own names."""
SOFTNESS = {
    "stiffness": "stiffness κ", "stiffness_both_cues": "κ with approach", "area_at_4_N": "area at 4 N",
    "spread_rate": "spread rate", "modulus": "modulus E*", "radius": "radius",
}  # fmt: skip
LOPSIDED = 0.1  # of an interval, by which its middle may lie beside twice the value
UNIT_WORDS = {"N_per_mm": "N/mm", "mm2": "mm²", "mm2_per_N": "mm²/N", "degrees": "°", "ratio": ""}
SHARES = ("seen",)  # told in percent


def named(column: str, unit: str) -> tuple[str, str]:
    """Plain words for a reading's column, and what it is; "" where its name says that."""
    quantity = _quantity(column, unit)
    return NAMES.get(quantity, (quantity, ""))


def _quantity(column: str, unit: str) -> str:
    return column.removesuffix(f"_{unit}")


def unread(known: Mapping[str, Told]) -> dict[str, Told]:
    """Rows of readings that a frame has none of, so that they stay where they are."""
    nothing = {"value": None, "low": None, "high": None, "valid": False, "why": "this frame was not read"}
    return {name: {**one, **nothing} for name, one in known.items()}


def force_beside(status: Told) -> float | None:
    """Force of the sensor beside as the frame was taken that is told; the newest where none was read [N]."""
    newest: float | None = status.get("force_N")
    of_frame: float | None = (status.get("reading") or {}).get("force_N")
    return newest if newest is None or of_frame is None else of_frame


def values_html(readings: Mapping[str, Told], status: Told) -> str:
    """Each reading with its interval and a lamp that has a shape of its own for each verdict; the reasons."""
    units = {column: str(one.get("unit", "")) for column, one in readings.items()}
    rows = [
        _value_html(*named(column, units[column]), _in_percent(column, one))
        for column, one in readings.items()
    ]
    reasons = _reasons((named(column, units[column])[0], one) for column, one in readings.items())
    force_n = force_beside(status)
    if force_n is not None:
        beside = f"<b>{number(float(force_n), 2)} N</b>"
        rows.append(f'<div class="value"><span class="what">sensor beside</span>{beside}</div>')
    image = status.get("image") or {}
    if not readings and image.get("verdict"):
        verdict = escape(str(image["verdict"]))
        what = '<span class="what">without a calibration</span>'
        rows.insert(0, f'<div class="value">{what}<b>{verdict}</b></div>')
        reasons = [f"<p>{escape(str(image.get('why') or ''))}</p>"]
    return "".join(rows) + _room(reasons) if rows else ""


def softness_html(compliance: Told | None) -> str:
    """Softness of the last press, each value with its interval and its lamp; "" where it is not read."""
    if compliance is None:
        return ""
    begin = "<h3>Softness of each press</h3>"
    if compliance.get("why"):
        return f'{begin}<p class="trouble">{escape(str(compliance["why"]))}</p>'
    presses = compliance.get("presses") or ()
    if not presses:
        return f'{begin}<p class="soft">No press has ended yet. Press slowly, to 4.5 N or more.</p>'
    last = presses[0]
    about = f"press {last['press']}, to {number(float(last['force_N']), 2)} N, {last['frames']} frames"
    named_rows = [(SOFTNESS.get(one["quantity"], one["quantity"]), one) for one in last["readings"]]
    told, reasons = "".join(_value_html(name, "", one) for name, one in named_rows), _reasons(named_rows)
    if last.get("why"):
        lamp = '<span class="verdict"><i class="lamp no">✕</i> not read</span>'
        told = f'<div class="value invalid"><span class="what">stiffness κ</span><b>–</b>{lamp}</div>'
        reasons = [f"<p>{escape(str(last['why']))}</p>"]
    earlier = [_kappa_words(one) for one in presses[1:]]
    before = f'<p class="soft">before: {"; ".join(earlier)}</p>' if earlier else ""
    return f'{begin}<p class="soft">{about}</p>{told}{_room(reasons)}{before}'


def _in_percent(column: str, one: Told) -> Told:
    """A share as it is told, in words; any other reading as it is."""
    value = one.get("value")
    if _quantity(column, str(one.get("unit", ""))) not in SHARES or not isinstance(value, int | float):
        return one
    return {**one, "value": f"{100 * value:.0f} %"}


def _kappa_words(press: Told) -> str:
    """Stiffness of a press before the last, in a few words."""
    kappa = next((one for one in press.get("readings") or () if one["quantity"] == "stiffness"), None)
    if kappa is None or kappa.get("value") is None:
        return f"press {press['press']} not read"
    unit = UNIT_WORDS.get(kappa["unit"], kappa["unit"])
    return (
        f"press {press['press']} {number(kappa['value'], 2)} {unit}{'' if kappa['valid'] else ' (not valid)'}"
    )


def _reasons(rows: Iterable[tuple[str, Told]]) -> list[str]:
    """Why values are not valid, each reason once with the values that it holds for."""
    of: dict[str, list[str]] = {}
    for name, one in rows:
        if not one.get("valid") and one.get("why"):
            of.setdefault(str(one["why"]), []).append(name)
    return [f"<p><b>{escape(', '.join(names))}</b>: {escape(why)}</p>" for why, names in of.items()]


def _room(reasons: list[str]) -> str:
    return (
        f'<div class="reasons soft" tabindex="0" role="group" aria-label="reasons">{"".join(reasons)}</div>'
    )


def _interval_words(value: float, one: Told, half: float) -> str:
    """An interval as half its width, or by both ends where the value does not lie in its middle."""
    low, high = float(one["low"]), float(one["high"])
    if abs(low + high - 2 * value) <= LOPSIDED * (high - low):
        return f"± {half_width_text(half)}"
    return f"({rounded(low, half)} to {rounded(high, half)})".replace("-", "−")


def _value_html(name: str, meaning: str, one: Told) -> str:
    valid = bool(one.get("valid"))
    lamp = '<i class="lamp ok">●</i> valid' if valid else '<i class="lamp no">✕</i> not valid'
    title = f' title="{escape(meaning)}"' if meaning else ""
    return (
        f'<div class="value {"" if valid else "invalid"}"><span class="what"{title}>{escape(name)}</span>'
        f'<b>{_value_words(one)}</b><span class="verdict">{lamp}</span></div>'
    )


def _value_words(one: Told) -> str:
    """A value in its unit, with its interval where it is valid and has one."""
    value, unit = one.get("value"), str(one.get("unit", ""))
    if not isinstance(value, int | float):
        return "–" if value is None else escape(str(value))
    low, high = one.get("low"), one.get("high")
    half = (float(high) - float(low)) / 2 if low is not None and high is not None else 0.0
    text = rounded(float(value), half) if half > 0 else number(float(value), 2)
    text = text.replace("-", "−") + f" {escape(UNIT_WORDS.get(unit, unit))}"
    if one.get("valid") and half > 0:  # what is counted has no interval, not one of 0
        text += f' <span class="half">{_interval_words(float(value), one, half)}</span>'
    return text
