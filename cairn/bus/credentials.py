"""Who one is on a bus that asks: a user's password, and certificates of TLS."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict

from cairn.errors import CairnError
from cairn.system.files import explain_os_error, explained

_LONGEST_PASSWORD: Final = 1024  # bytes
_TLS_BUFFER: Final = 16 << 20
"""Size of a TLS socket's buffers [bytes].

zenoh 1.10 does not flush what TLS has buffered: the end of a message larger than the socket's
buffer would wait for the next keep-alive, up to 1.25 s.
"""
_VARIABLES: Final = {
    "CAIRN_USER": "user",
    "CAIRN_PASSWORD_FILE": "password_file",
    "CAIRN_TLS_CA": "ca",
    "CAIRN_TLS_CERTIFICATE": "certificate",
    "CAIRN_TLS_KEY": "key",
}


class Credentials(BaseModel):
    """What a session presents to a router on the network. It names files; it has no secrets."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    user: str | None = None
    password_file: str | None = None
    ca: str | None = None
    """Certificates (PEM) of the authorities that may sign the router's certificate."""
    certificate: str | None = None
    key: str | None = None

    @classmethod
    def from_environment(cls) -> Credentials:
        """Return those that the environment names, as for commands."""
        named = {
            field: value for name, field in _VARIABLES.items() if (value := os.environ.get(name))
        }
        if ("user" in named) != ("password_file" in named):
            raise CairnError(
                "CAIRN_USER and CAIRN_PASSWORD_FILE belong together, and only one of them is set; "
                "set both or none"
            )
        if ("certificate" in named) != ("key" in named):
            raise CairnError(
                "CAIRN_TLS_CERTIFICATE and CAIRN_TLS_KEY belong together, and only one of them is "
                "set; set both or none"
            )
        return cls(**named)

    def presented(self) -> str:
        """Describe what a session presents, without secrets, for messages."""
        if self.user is not None:
            return f"user {self.user} with the given password"
        if self.certificate is not None:
            return f"the certificate {self.certificate}"
        return "a client without user name and certificate"

    def session_settings(self, own_dictionary: Path | None = None) -> dict[str, Any]:
        """Return the settings of a Zenoh session that presents them.

        `own_dictionary` is a new file for the passwords that the session accepts on its own links:
        this user's, so that all processes of a deployment link to each other. Raises `CairnError`
        if a file cannot be read, or a secret is readable by other users. Never print the settings:
        they contain the password.
        """
        settings: dict[str, Any] = {}
        if self.user is not None and self.password_file is not None:
            password = read_password(Path(self.password_file))
            login = {"user": self.user, "password": password}
            if own_dictionary is not None:
                write_dictionary(own_dictionary, {self.user: password})
                login["dictionary_file"] = str(own_dictionary)
            settings["transport/auth/usrpwd"] = login
            # In zenoh 1.10 two sessions that authenticate each other and connect at the same time
            # may both close the other's link permanently; so only one of the two connects.
            one_side = {"peer": {"to_router": "always", "to_peer": "greater-zid"}}
            settings["scouting/gossip/autoconnect_strategy"] = one_side
        if self.ca is not None:
            check_readable(Path(self.ca))
            tls: dict[str, Any] = {"root_ca_certificate": self.ca, **TLS_BUFFERS}
            if self.certificate is not None and self.key is not None:
                check_readable(Path(self.certificate))
                check_secret(Path(self.key))
                tls |= {
                    "enable_mtls": True,
                    "connect_certificate": self.certificate,
                    "connect_private_key": self.key,
                }
            settings["transport/link/tls"] = tls
        return settings


NO_CREDENTIALS: Final = Credentials()

TLS_BUFFERS: Final = {"so_sndbuf": _TLS_BUFFER, "so_rcvbuf": _TLS_BUFFER}


def read_password(path: Path) -> str:
    """Return the password in a file: its only line, without spaces at its ends.

    Raises `CairnError` if the file cannot be read, other users may read it, or it has no password.
    """
    check_secret(path)
    try:
        with path.open("rb") as file:
            text = file.read(_LONGEST_PASSWORD + 2).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = explain_os_error(error) if isinstance(error, OSError) else "it is not UTF-8"
        raise CairnError(f"{path}: the password cannot be read: {reason}") from error
    password = text.strip()
    if not password or len(text) > _LONGEST_PASSWORD or not password.isprintable():
        raise CairnError(
            f"{path}: it does not contain one line with a password of at most {_LONGEST_PASSWORD} "
            "bytes; write one, for example: (umask 077; openssl rand -hex 24 > FILE)"
        )
    return password


def write_dictionary(path: Path, passwords: dict[str, str]) -> None:
    """Write a file with the passwords of users, in Zenoh's format, for its owner alone."""
    text = "".join(f"{user}:{password}\n" for user, password in passwords.items())
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW
    with os.fdopen(os.open(path, flags, 0o600), "w", encoding="utf-8") as file:
        file.write(text)


def check_readable(path: Path) -> None:
    """Raise `CairnError` unless a path is a file that this user may read."""
    with explained(f"{path}: it cannot be read"):
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise CairnError(f"{path}: it is not a file; name the file")
        os.close(os.open(path, os.O_RDONLY | os.O_NONBLOCK))


def check_pair(certificate: Path, key: Path) -> None:
    """Raise `CairnError` unless a private key is secret, and belongs to a certificate."""
    import ssl  # takes 7 ms: not for every process

    check_readable(certificate)
    check_secret(key)
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password="")
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        raise CairnError(
            f"{key}: it is not the private key (PEM, without password) of {certificate}: "
            f"{error}; name the files that belong together"
        ) from error


def check_authorities(path: Path) -> None:
    """Raise `CairnError` unless a file contains certificates (PEM)."""
    import ssl  # takes 7 ms: not for every process

    check_readable(path)
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(path)
    except (OSError, ValueError) as error:
        raise CairnError(
            f"{path}: it contains no certificates (PEM): {error}; name the file of the authority"
        ) from error


def check_secret(path: Path) -> None:
    """Raise `CairnError` unless a path is a readable file that other users may not read."""
    check_readable(path)
    status = path.stat()
    if status.st_mode & (stat.S_IRWXO | stat.S_IWGRP):
        raise CairnError(
            f"{path}: other users may read or change this secret (mode "
            f"{stat.S_IMODE(status.st_mode):04o}); run: chmod 600 {path}"
        )
    if status.st_uid not in (0, os.geteuid()):
        raise CairnError(
            f"{path}: this secret belongs to user {status.st_uid}, who may change it; copy it to a "
            "file of your own"
        )
