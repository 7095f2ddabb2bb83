"""The section `bus` of a deployment: where its router listens, and who may connect to it."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from cairn.bus.credentials import (
    Credentials,
    check_authorities,
    check_pair,
    check_readable,
    read_password,
)
from cairn.bus.endpoints import is_encrypted, is_loopback, parse_endpoint, socket_path
from cairn.bus.message_limits import LONGEST_MAX_BYTES, MAX_MESSAGE_SIZE
from cairn.bus.roles import Role
from cairn.errors import CairnError
from cairn.runtime.child_spec import Section
from cairn.system.runtime_folder import check_private, group_id

_REMEDY = (
    "add `users` with passwords, or `tls` with `identity` (cairn security), or `tls` with client "
    "certificates and `certificate_roles`, or, on loopback, `allow_any_local_user: true`"
)


def _network_endpoint(text: str) -> str:
    if socket_path(endpoint := parse_endpoint(text)) is not None:
        raise ValueError(
            f"{text!r} is a Unix socket; name it under `bus.socket`, and network endpoints such as "
            "tcp/127.0.0.1:7447 here"
        )
    return endpoint


def _absolute_path(text: str) -> str:
    path = socket_path(parse_endpoint(text))
    if path is None:
        raise ValueError(
            f"{text!r} is not the absolute path of a socket, such as /run/cairn/robot.sock; "
            "network endpoints belong under `bus.listen`"
        )
    return str(path)


Endpoint = Annotated[str, AfterValidator(parse_endpoint)]
NetworkEndpoint = Annotated[str, AfterValidator(_network_endpoint)]
SocketPath = Annotated[str, AfterValidator(_absolute_path)]
UserName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=64)]
CommonName = Annotated[str, Field(min_length=1, max_length=64)]
FilePath = Annotated[str, Field(min_length=1, max_length=4096)]


class BusUser(Section):
    """A user on the network, who connects with a password."""

    role: Role = Field(
        description="view: read topics and states; operate: also give goals; administer: "
        "everything."
    )
    password_file: FilePath = Field(
        description="File with the user's password, which other users may not read."
    )


class TlsSettings(Section):
    """Certificates (PEM files) for encrypted endpoints, tls/HOST:PORT and quic/HOST:PORT."""

    identity: UserName | None = Field(
        None,
        description="Identity of `cairn security` on this computer with which `listen` opens. It "
        "brings certificate and authority; operators connect while the roster has them in force, "
        "with their roles there.",
    )
    certificate: FilePath | None = Field(None, description="This deployment's certificate.")
    key: FilePath | None = Field(
        None, description="Private key of `certificate`, which other users may not read."
    )
    ca: FilePath | None = Field(
        None, description="Certificates of the authorities that sign those of the other side."
    )
    client_certificates: bool = Field(
        False, description="Accepts only clients with a certificate that `ca` has signed."
    )
    certificate_roles: dict[CommonName, Role] = Field(
        default_factory=dict, description="Role of each client, by its certificate's common name."
    )

    @model_validator(mode="after")
    def _complete(self) -> "TlsSettings":
        others = [name for name, value in self if name != "identity" and value]
        if self.identity is not None and others:
            named = ", ".join(f"`{one}`" for one in others)
            raise ValueError(
                "`identity` brings the certificate, the authority and the operators with their "
                f"roles; remove {named}, or `identity`"
            )
        if (self.certificate is None) != (self.key is None):
            raise ValueError("`certificate` and `key` belong together; name both or none")
        if self.client_certificates and self.ca is None:
            raise ValueError("`client_certificates` needs `ca`, the authority that signs them")
        if self.certificate_roles and not self.client_certificates:
            raise ValueError(
                "`certificate_roles` needs `client_certificates: true`, or a client without a "
                "certificate could connect"
            )
        return self


class BusSettings(Section):
    """How the components of the deployment connect to each other over Zenoh, and who else may."""

    allow_remote: bool = Field(
        False, description="Allows `listen` to be reachable from other machines."
    )
    allow_any_local_user: bool = Field(
        False,
        description="Lets any user and program of this computer connect to `listen`, which must be "
        "a loopback address, without a password, and drive the robot.",
    )
    connect: tuple[Endpoint, ...] = Field(
        (),
        strict=False,
        max_length=32,
        description="Endpoints of running routers to join; then `cairn up` opens none.",
    )
    user: UserName | None = Field(None, description="User name for the routers of `connect`.")
    password_file: FilePath | None = Field(
        None, description="File with the password of `user`, which other users may not read."
    )
    socket: SocketPath | None = Field(
        None,
        description="Path of the Unix socket on which `cairn up` opens the deployment's router; by "
        "default domain-N.sock in the user's runtime folder.",
    )
    group: str | None = Field(
        None,
        min_length=1,
        max_length=32,
        description="Group whose members may connect to the socket, too.",
    )
    users: dict[UserName, BusUser] = Field(
        default_factory=dict,
        max_length=100,
        description="Users who may connect to `listen`, by name.",
    )
    tls: TlsSettings | None = Field(
        None, description="Certificates for encrypted endpoints of `listen` and `connect`."
    )
    max_message_size: int | None = Field(
        None,
        ge=64 << 10,
        le=LONGEST_MAX_BYTES,
        description="Longest message [bytes]; every process discards longer ones unread. By "
        f"default {MAX_MESSAGE_SIZE}, or more if an input accepts more.",
    )
    listen: tuple[NetworkEndpoint, ...] = Field(
        (),
        strict=False,
        max_length=32,
        description="Network endpoints on which the router listens as well.",
    )

    @property
    def credentials(self) -> Credentials:
        """What the deployment presents to the routers of `connect`."""
        tls = self.tls or TlsSettings()
        return Credentials(
            user=self.user,
            password_file=self.password_file,
            ca=tls.ca,
            certificate=tls.certificate,
            key=tls.key,
        )

    @classmethod
    def valid_part(cls, values: Mapping[str, Any]) -> "BusSettings":
        """Return the settings with those values that are valid each for itself."""
        valid = {}
        for key in values.keys() & cls.model_fields.keys():
            with suppress(ValidationError):
                valid[key] = TypeAdapter(cls.__annotations__[key]).validate_python(values[key])
        return cls.model_construct(**valid)

    def file_problems(self) -> Iterator[tuple[tuple[str, ...], str]]:
        """Yield what this computer does not have as needed, by key below `bus`, with the reason."""
        checks: list[tuple[tuple[str, ...], str | None, Callable[[Path], object]]] = [
            (("socket",), self.socket, _check_folder),
            (("password_file",), self.password_file, read_password),
            *(
                (("users", name, "password_file"), user.password_file, read_password)
                for name, user in self.users.items()
            ),
        ]
        if (tls := self.tls) is not None:
            checks += [
                (("tls", "certificate"), tls.certificate, check_readable),
                (("tls", "key"), tls.key, lambda key: check_pair(Path(tls.certificate or ""), key)),
                (("tls", "ca"), tls.ca, check_authorities),
            ]
        for key, path, check in checks:
            if path is not None:
                try:
                    check(Path(path))
                except CairnError as error:
                    yield key, str(error)
        try:
            if self.group is not None:
                group_id(self.group)
        except CairnError as error:
            yield ("group",), str(error)

    @field_validator("socket", "group", "users", "listen", mode="after")
    @classmethod
    def _no_router_to_open(cls, value: object, info: ValidationInfo) -> object:
        if info.data.get("connect") and value:
            raise ValueError(
                f"with `connect` no router is opened, so `{info.field_name}` has no effect; keep "
                f"`connect` to join a router that runs already, or `{info.field_name}` to open one"
            )
        return value

    @field_validator("listen", mode="after")
    @classmethod
    def _listens_on_purpose(cls, listen: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        if info.data.keys() >= {"allow_remote", "allow_any_local_user", "users", "tls"}:
            _reject(
                cls, listen, (text for one in listen for text in _access_problems(one, info.data))
            )
        return listen

    @model_validator(mode="after")
    def _has_effect(self) -> "BusSettings":
        _reject(type(self), None, self._conflicts())
        return self

    def _conflicts(self) -> Iterator[str]:
        """Yield which values have no effect, or not the effect that is meant, together."""
        if self.user is not None and not self.connect:
            yield "`user` is who joins the routers of `connect`; add `connect`"
        if (self.user is None) != (self.password_file is None):
            yield "`user` and `password_file` belong together; name both or none"
        if self.user is not None and any(map(socket_path, self.connect)):
            yield "a Unix socket of `connect` accepts no password; remove `user`"
        if self.users and not self.listen:
            yield (
                "`users` connect to `listen`, which is empty; add an endpoint to `listen` "
                "(a Unix socket is opened to others by `group`)"
            )
        if self.users and self.tls is not None:
            for key in ("certificate_roles", "identity"):
                if getattr(self.tls, key):
                    yield f"the roles come either from `users` or from `tls.{key}`; remove one"
        if self.tls is not None and self.tls.identity is not None and not self.listen:
            yield "`tls.identity` opens the endpoints of `listen`, which is empty; add one"
        if any(map(is_encrypted, self.connect)) and (self.tls is None or self.tls.ca is None):
            yield (
                "an encrypted endpoint of `connect` needs `tls: {ca: FILE}`, the authority that "
                "has signed the router's certificate"
            )


def _check_folder(socket: Path) -> None:
    """Raise `CairnError` if other users could open or replace a socket."""
    with suppress(OSError):  # `cairn up` creates it
        check_private(socket.parent)


def _reject(model: type[BaseModel], value: object, reasons: Iterable[str]) -> None:
    """Raise one error with all reasons, if there are any."""
    details = [
        InitErrorDetails(
            type=PydanticCustomError("value_error", "{reason}", {"reason": reason}),
            loc=(),
            input=value,
        )
        for reason in reasons
    ]
    if details:
        raise ValidationError.from_exception_data(model.__name__, details)


def _access_problems(endpoint: str, bus: Mapping[str, object]) -> Iterator[str]:
    """Yield why an endpoint would let in users who are not entitled, or none who are."""
    tls, users = bus["tls"], bus["users"]
    certificate_roles = isinstance(tls, TlsSettings) and bool(tls.certificate_roles or tls.identity)
    is_open = not (users or certificate_roles or bus["allow_any_local_user"])
    is_remote = not is_loopback(endpoint) and not bus["allow_remote"]
    if is_remote:
        and_open = ", and anyone who reaches it could drive the robot" if is_open else ""
        and_close = f"; in both cases {_REMEDY}" if is_open else ""
        yield (
            f"{endpoint} can be reached from other machines{and_open}; listen on 127.0.0.1, or add "
            f"`allow_remote: true`{and_close}"
        )
    if is_encrypted(endpoint) and not (
        isinstance(tls, TlsSettings) and (tls.certificate or tls.identity)
    ):
        yield (
            f"{endpoint} is encrypted and needs a certificate; add "
            "`tls: {identity: NAME}` (cairn security), or `tls: {certificate: FILE, key: FILE}`"
        )
    if bus["allow_any_local_user"]:
        if users or certificate_roles:
            yield (
                "`allow_any_local_user` asks for no password or certificate; remove it, or "
                "remove `users`, `tls.certificate_roles` and `tls.identity`"
            )
        if not is_loopback(endpoint):
            yield (
                f"{endpoint} can be reached from other machines, and `allow_any_local_user` is for "
                f"loopback only; {_REMEDY}"
            )
        if is_encrypted(endpoint):
            yield (f"{endpoint}: with `allow_any_local_user` encryption protects nothing; use tcp/")
    elif certificate_roles and not is_encrypted(endpoint):
        yield (
            f"{endpoint} carries no certificates, by which `tls` knows clients; use a tls/ or "
            "quic/ endpoint, or `users`"
        )
    elif is_open and not is_remote:
        yield f"anyone who reaches {endpoint} could drive the robot; {_REMEDY}"
