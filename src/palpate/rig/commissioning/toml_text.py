"""A rig's fields as TOML text: values first, then a table for each part."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml_text(fields: Mapping[str, Any]) -> str:
    """Fields of texts, numbers, lists of these, and one depth of tables.

    Example:
        >>> print(toml_text({"name": "a", "stage": {"home": True, "axes": ["+X"]}}), end="")
        name = "a"
        <BLANKLINE>
        [stage]
        home = true
        axes = ["+X"]
    """
    plain = [f"{name} = {_value(value)}" for name, value in fields.items() if not isinstance(value, Mapping)]
    for name, table in fields.items():
        if isinstance(table, Mapping):
            plain += ["", f"[{name}]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    return "\n".join(plain) + "\n"


def _value(value: Any) -> str:
    """A value; JSON's texts, numbers, lists and truths are TOML's, but for the character DEL."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(one) for one in value)}]"
    return json.dumps(value, allow_nan=False).replace("\x7f", "\\u007f")
