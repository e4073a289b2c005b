"""What ``pid fly`` is given: gains, a model, and the firmware that they are for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation import BadInputError
from groundstation.cli.model_files import fitted_model

if TYPE_CHECKING:
    from groundstation.control.firmwares import Release


@dataclass(frozen=True, slots=True)
class Whose:
    """The files of gains and of the model, and the firmware that the user says they are for."""

    gains: Path | None
    model: str | None
    said: str | None

    def wanted(self) -> dict[str, float]:
        """The gains. Raises BadInputError for what is wrong with any: better known before a
        flight."""
        from groundstation.control.firmware_loop import plant_of_model
        from groundstation.control.firmwares import require_release

        wanted = {} if self.gains is None else _firmware_gains(self.gains)
        if self.said is not None:
            require_release(self.said)
        if self.model is not None:
            plant_of_model(fitted_model(self.model), release=self.said)
        return wanted

    def require(self, craft: str, uri: str) -> Release | None:
        """The firmware of the craft that calls its own ``craft`` (empty: it does not say).

        Raises BadInputError where gains or model are another's: the same parameters mean other
        numbers there.
        """
        from groundstation import load_model
        from groundstation.control.firmware_loop import require_gains_of
        from groundstation.control.firmwares import firmware_of_vehicle, require_release
        from groundstation.dynamics.model import model_vehicle

        if not (craft or self.said):
            if self.gains is None and self.model is None:
                return None
            raise BadInputError(
                f"{uri} does not say whose loops it flies; say --firmware 2014 or --firmware 2.x"
            )
        if craft and self.said and craft != self.said:
            raise BadInputError(f"--firmware {self.said}: {uri} flies {craft}; nothing was written")
        release = require_release(craft or str(self.said))
        if self.gains is not None:
            require_gains_of(self.gains, release, uri, said=self.said)
        if self.model is not None and self.said is None:
            vehicle = model_vehicle(load_model(self.model))
            if firmware_of_vehicle(vehicle).name != release:
                raise BadInputError(
                    f"model {self.model}: a {vehicle.name} flies {vehicle.firmware}, {uri} flies"
                    f" {release}: not of this craft, or say --firmware {release}"
                )
        return release


def _firmware_gains(path: Path) -> dict[str, float]:
    """The firmware's gains of a file. Raises BadInputError for others, which cannot be flown."""
    from groundstation import PidGains, load_gains
    from groundstation.control.firmware_loop import require_gains

    wanted: dict[str, float] = {}
    for name, value in load_gains(path).items():
        if isinstance(value, PidGains):
            raise BadInputError(
                f"gains {path}: the thesis's form cannot be flown, only the firmware's"
            )
        wanted[name] = value
    require_gains(wanted, f"gains {path}")
    return wanted
