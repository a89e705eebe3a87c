"""Ground of every card: parts that refuse what they do not know, and documents whose id is their own hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_serializer

from palpate.core import CertificateError
from palpate.core.parsing import parser
from palpate.core.provenance import Provenance, earlier_provenance
from palpate.version import needed_version


class CardPart(BaseModel):
    """Part of a card.

    Attributes:
        added: Fields added later; those that are None are omitted from the text, so that ids of older cards
            hold.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")
    added: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _dumped(self, dump: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        return {k: v for k, v in dump(self).items() if v is not None or k not in self.added}


class FileCard(CardPart):
    """File of a calibration, and the hash of its bytes."""

    file: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class RunCard(CardPart):
    """Recording used for training."""

    run_id: str
    hash: str
    frames: int
    origin: str
    licence: str
    provenance: Provenance | None = None
    added = ("provenance",)

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated sensor gave it, see `recordings.Manifest.is_simulated`."""
        return (self.provenance or earlier_provenance(self.origin)) is Provenance.SIMULATED


def card_id(content: Mapping[str, Any]) -> str:
    """Return twelve hexadecimal digits from the card's content without its `id`."""
    rest = {key: value for key, value in content.items() if key != "id"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


class SealedCard(CardPart):
    """Document whose `id` is a hash of everything else in it, so that changes are detected."""

    id: str


S = TypeVar("S", bound=SealedCard)


@parser("sealed card", CertificateError)
def sealed_from(kind: type[S], text: bytes, path: Path, own_format: str, what: str, remedy: str) -> S:
    """Read a sealed document, called `what` in messages; `remedy` is for a damaged one."""
    try:
        found = kind.model_validate_json(text)
    except ValidationError as e:
        if version := needed_version(text, own_format):
            raise CertificateError(f"{path} {version}", code="card-version") from e
        first = e.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the text"
        raise CertificateError(
            f"{path} cannot be read as {what}: {where}: {first['msg']}; {remedy}", code="card-damaged"
        ) from e
    if card_id(found.model_dump(mode="json")) != found.id:
        raise CertificateError(
            f"{path} was altered: it does not match its id {found.id}; {remedy}", code="card-altered"
        )
    return found
