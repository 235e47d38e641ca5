"""Settings of the motion capture."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Self

from pydantic import Field, IPvAnyAddress, model_validator

from imolo.config.model import Model, Positive
from imolo.contracts.robot import Body

Port = Annotated[int, Field(ge=1, le=65535)]


class MarkerLabels(Model):
    """Which marker of Motive's is which of ours."""

    asset: str | None = Field(
        None, description="the rigid body, marker set or skeleton of the markers; the robot's name if not given"
    )
    model_id: Annotated[int, Field(ge=1, le=0xFFFF)] | None = Field(
        None,
        description="streaming id of the asset, where the model definitions do not tell it (marker sets before 4.1)",
    )
    markers: dict[str, Annotated[int, Field(ge=0)]] | None = Field(
        None, description="Motive's name of a marker to our `marker_id`; the robot's own names if not given"
    )

    @model_validator(mode="after")
    def _each_label_once(self) -> Self:
        markers = self.markers or {}
        if len(set(markers.values())) < len(markers):
            raise ValueError("two markers have the same label")
        return self

    def of(self, body: Body) -> "NamedMarkers":
        """Return what the cameras call the markers of a robot."""
        markers = self.markers or {marker.name: marker.marker_id for marker in body.markers}
        return NamedMarkers(self.asset or body.name, self.model_id, markers)


@dataclass(frozen=True)
class NamedMarkers:
    """What Motive calls the markers of a robot: see `MarkerLabels`."""

    asset: str
    model_id: int | None
    markers: Mapping[str, int]


class NatNetConfig(Model):
    """How the motion capture is reached; whether it sends unicast or multicast, and where to, it says itself."""

    server_address: IPvAnyAddress = Field("127.0.0.1", validate_default=True, description="of the computer with Motive")
    local_address: IPvAnyAddress = Field(
        "127.0.0.1", validate_default=True, description="of our network card towards it"
    )
    command_port: Port = Field(1510, description="of Motive, its default")
    silence_limit: Positive = Field(
        0.035,
        description="frames missing for so long are a lost stream [s]: 4 at 120 Hz; 15 ms are left to tell it in 50",
    )
    retry_interval: Positive = Field(0.2, description="between two questions without answer [s], assumed")
    keep_alive_interval: Positive = Field(1.0, description="between two signs of life in unicast [s], assumed")
    echo_interval: Positive = Field(0.1, description="between two questions for the server's clock [s], assumed")
    clock_drift: Positive = Field(1e-4, description="of two computers' clocks at most [-], assumed: 3 times 0.03 ms/s")
    labels: MarkerLabels = MarkerLabels()


class NatNetServerConfig(Model):
    """Where the emulated motion capture is; by default nothing leaves this machine."""

    address: IPvAnyAddress = Field("127.0.0.1", validate_default=True, description="of our network card")
    command_port: Annotated[int, Field(ge=0, le=65535)] = Field(1510, description="Motive's default; 0 is any free one")
    data_port: Port = Field(1511, description="Motive's default, for multicast")
    multicast_group: IPvAnyAddress | None = Field(
        None, description="such as 239.255.42.99, Motive's default; none is unicast"
    )
    ttl: Annotated[int, Field(ge=0, le=255)] = Field(0, description="routers that multicast passes; 0 is this machine")
    client_timeout: Positive = Field(10.0, description="after which a silent unicast client is dropped [s], assumed")
