"""How a robot differs from one trial to the next."""

from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator

from imolo.config.model import Model, NonNegative


class DisturbanceConfig(Model):
    """How much the robot differs from one trial to the next; every value is a standard deviation.

    A subclass adds what its actuators know of. `profiles` holds the values of each named profile; under `custom` the
    values are those of the config.
    """

    profiles: ClassVar[dict[str, dict[str, float]]] = {"none": {}, "realistic": {"joint_angle": 0.001}}

    profile: Literal["none", "realistic", "custom"] = Field(
        "realistic", description="sets all values below; `custom` leaves them to the config"
    )
    joint_angle: NonNegative = Field(0.0, description="of each joint in the ready pose, inwards from its limit [rad]")

    @model_validator(mode="before")
    @classmethod
    def _profile_sets_the_values(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        profile = str(values.get("profile", "realistic"))
        if profile not in cls.profiles:
            return values
        named = {key: cls.profiles[profile].get(key, 0.0) for key in cls.model_fields if key != "profile"}
        for key, value in values.items():
            if key in named and value != named[key]:
                raise ValueError(f"profile {profile!r} sets {key} itself; use `profile: custom` to choose {key}")
        return {**values, **named}
