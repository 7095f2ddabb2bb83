"""The section `bus` of a deployment: where its router listens, and who may connect to it."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from cairn.bus.endpoints import is_loopback, parse_endpoint, socket_path


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


class BusSettings(BaseModel):
    """How the components of the deployment connect to each other over Zenoh, and who else may."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, validate_default=True)

    allow_remote: bool = Field(
        False, description="Allows `listen` to be reachable from other machines."
    )
    connect: tuple[Endpoint, ...] = Field(
        (),
        strict=False,
        description="Endpoints of running routers to join; then `cairn up` opens none.",
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
    listen: tuple[NetworkEndpoint, ...] = Field(
        (), strict=False, description="Network endpoints on which the router listens as well."
    )

    @field_validator("socket", "group", "listen", mode="after")
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
    def _remote_on_purpose(cls, listen: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        for endpoint in listen:
            if not info.data.get("allow_remote", True) and not is_loopback(endpoint):
                raise ValueError(
                    f"{endpoint} can be reached from other machines; listen on 127.0.0.1, or add "
                    "`allow_remote: true` if anyone on that network may drive the robot"
                )
        return listen
