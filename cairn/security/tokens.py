"""Tokens for enrollment: each makes one new machine or operator known, once and for minutes.

The authority's computer keeps only hashes. A secret has 256 random bits, so its hash needs no salt
and cannot be searched.
"""

from __future__ import annotations

import base64
import binascii
import secrets
from hashlib import sha256
from typing import Annotated, Final
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, ValidationError

from cairn.bus.roles import Role
from cairn.errors import CairnError
from cairn.security.folder import Kind, Name, RobotFolder, write_secret
from cairn.security.roster import StrictModel, Time

LONGEST_TOKEN: Final = 2_000  # characters
LONGEST_VALID_S: Final = 7 * 86_400
_MOST_TOKENS: Final = 100
_STORE_BYTES: Final = 256 << 10
_PREFIX: Final = "cairn1."
_NEW_TOKEN: Final = "make a new one on the authority's computer: cairn security token NAME"


class TokenRefused(CairnError):
    """A token is unknown, was used, has expired, or is of another identity."""

    def __init__(self) -> None:
        super().__init__(
            f"the token is wrong, was used already, has expired, or is of another identity; "
            f"{_NEW_TOKEN}"
        )


def _service_url(text: str) -> str:
    parts = urlsplit(text)
    if parts.scheme != "https" or not parts.hostname or parts.port is None:
        raise ValueError("it is not https://HOST:PORT")
    if parts.path or parts.query or parts.fragment or parts.username is not None:
        raise ValueError("it has more than https://HOST:PORT")
    return text


ServiceUrl = Annotated[str, Field(max_length=300), AfterValidator(_service_url)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Token(StrictModel):
    """What a token contains, for the computer that enrolls."""

    url: ServiceUrl
    ca: Digest
    """Fingerprint (SHA-256) of the authority's certificate."""
    robot: Name
    name: Name
    secret: Digest

    def encode(self) -> str:
        """Return the text that is copied to the new computer."""
        data = base64.urlsafe_b64encode(self.model_dump_json().encode())
        return _PREFIX + data.decode("ascii").rstrip("=")


def decode_token(text: str) -> Token:
    """Return the content of a token's text; `CairnError` if it is not complete."""
    body = text.strip()
    try:
        if len(body) > LONGEST_TOKEN or not body.startswith(_PREFIX):
            raise ValueError("it does not start as a token")
        encoded = body.removeprefix(_PREFIX).encode("ascii")
        padded = encoded + b"=" * (-len(encoded) % 4)
        return Token.model_validate_json(base64.b64decode(padded, b"-_", validate=True))
    except (ValueError, binascii.Error):  # pydantic's and UnicodeError are a ValueError
        raise CairnError(
            f"{body[:16]}...: it is not a whole token; copy all of the line that "
            "`cairn security token NAME` has printed"
        ) from None


class _StoredToken(StrictModel):
    digest: Digest
    name: Name
    kind: Kind
    role: Role | None
    expires: Time


class _TokenFile(StrictModel):
    tokens: Annotated[tuple[_StoredToken, ...], Field(max_length=_MOST_TOKENS)] = ()


def store_token(
    folder: RobotFolder, name: str, kind: Kind, role: Role | None, expires: int, now: float
) -> str:
    """Store the hash of a new secret and return the secret; the caller holds the folder's lock."""
    kept = [one for one in _read(folder) if one.expires > now]
    if len(kept) >= _MOST_TOKENS:
        raise CairnError(
            f"{folder.tokens}: {_MOST_TOKENS} tokens are valid already; use them, or wait until "
            "they have expired"
        )
    secret = secrets.token_hex(32)
    kept.append(
        _StoredToken(digest=_digest(secret), name=name, kind=kind, role=role, expires=expires)
    )
    _write(folder, kept)
    return secret


def redeem(
    folder: RobotFolder, name: str, kind: Kind, role: Role | None, secret: str, now: float
) -> None:
    """Use up the token with a secret; the caller holds the folder's lock.

    Raises `TokenRefused` unless it is valid for this identity, kind and role.
    """
    digest = _digest(secret)
    stored = _read(folder)
    found = [secrets.compare_digest(one.digest, digest) for one in stored]  # all: constant time
    kept = [one for one, matches in zip(stored, found, strict=True) if not matches]
    matching = [one for one, matches in zip(stored, found, strict=True) if matches]
    if not matching:
        raise TokenRefused
    _write(folder, kept)
    for one in matching:
        if (one.name, one.kind, one.role) != (name, kind, role) or one.expires <= now:
            raise TokenRefused


def discard_tokens(folder: RobotFolder, name: str) -> None:
    """Remove the tokens of an identity; the caller holds the folder's lock."""
    stored = _read(folder)
    kept = [one for one in stored if one.name != name]
    if len(kept) < len(stored):
        _write(folder, kept)


def _digest(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()


def _read(folder: RobotFolder) -> list[_StoredToken]:
    if not folder.tokens.exists():
        return []
    data = folder.read(folder.tokens, _STORE_BYTES, _NEW_TOKEN)
    try:
        return list(_TokenFile.model_validate_json(data).tokens)
    except ValidationError as error:
        raise CairnError(
            f"{folder.tokens}: it is damaged ({error.errors()[0]['msg']}); remove it, and make new "
            "tokens"
        ) from None


def _write(folder: RobotFolder, tokens: list[_StoredToken]) -> None:
    store = _TokenFile(tokens=tuple(tokens))
    write_secret(folder.tokens, store.model_dump_json().encode() + b"\n")
