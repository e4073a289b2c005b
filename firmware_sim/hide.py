"""``python -m firmware_sim.hide``: a craft with something wrong in it, and nobody told what.

The seed chooses one effect, or several, and their sizes. They go into a new settings file, which
flies the craft like any other; opening it is giving up.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from pathlib import Path

import numpy as np

from firmware_sim.craft import StandIn
from firmware_sim.effects.catalogue import EFFECTS, draw
from firmware_sim.physics import craft_of, present_effects
from firmware_sim.settings import StandInSettings, load_settings, parse_settings
from groundstation.text import printable

HIDEABLE = tuple(
    sorted(
        (name for name, one in EFFECTS.items() if one.hidden is not None),
        key=lambda name: EFFECTS[name].hidden or 0,
    )
)
"""Effects that any ordinary flight shows at every size drawn; neighbours are unlike each other,
so that one seed after the other is another story."""
DRAWS = 20
"""Times that sizes are drawn for one with which the craft still flies on its own gains."""
FLOWN_S, LEAN_DEG, RATE_DPS = 20.0, 60.0, 800.0
"""It flies: for so long of its programme it leans and turns less than this."""

EXAMPLE = """example:
  python -m firmware_sim.hide --settings craft.toml --seed 3 -o sealed.toml
"""


def main(arguments: list[str] | None = None) -> int:
    """Write the file. Returns 0, or 1 after one line on stderr."""
    parser = argparse.ArgumentParser(
        prog="python -m firmware_sim.hide",
        description="Hide an effect, chosen by seed, in a craft of the stand-in.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--settings", type=Path, required=True, help="the craft without it")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--effects", type=int, default=1, metavar="N", help="how many (default 1)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="a new TOML file")
    options = parser.parse_args(arguments)
    try:
        text = _sealed(options.settings, options.seed, options.effects)
        with options.output.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        print(f"firmware_sim: {options.output} exists already; give another name", file=sys.stderr)
        return 1
    except (ValueError, OSError) as error:
        print(f"firmware_sim: {printable(str(error))}", file=sys.stderr)
        return 1
    print(f"{options.output}: something is hidden in this craft")
    return 0


def _sealed(settings: Path, seed: int, count: int) -> str:
    """The settings' own text, and tables with what is hidden at its end."""
    if seed < 0:
        raise ValueError(f"--seed {seed}: must not be negative")
    if not 1 <= count <= len(HIDEABLE):
        raise ValueError(f"--effects {count}: must be 1..{len(HIDEABLE)}")
    plain = load_settings(settings)
    generator = np.random.default_rng(seed)
    names = [HIDEABLE[seed % len(HIDEABLE)]]
    if count > 1:
        others = [name for name in HIDEABLE if name not in names]
        names += generator.choice(others, count - 1, replace=False).tolist()
    if plain.effects:
        raise ValueError(f"{settings}: this craft has effects already; start from one without")
    for name in sorted(set(names) & set(present_effects(plain))):
        _, model = craft_of(plain)
        modelled = model is not None and any(one.name == name for one in model.effects)
        remedy = "a model without it" if modelled else 'one with plant = "reduced"'
        raise ValueError(
            f"{settings}: this craft has {name} from the start, and seed {seed} would hide it;"
            f" start from {remedy}"
        )
    text = settings.read_text(encoding="utf-8")
    table = "stand_in.effects" if "stand_in" in tomllib.loads(text) else "effects"
    for _ in range(DRAWS):
        lines = []
        for name in names:
            values = draw(name, generator)
            lines += ["", f"[{table}.{name}]"]
            lines += [f"{key} = {float(f'{value:.4g}')!r}" for key, value in values.items()]
        sealed = "\n".join([text.rstrip(), *lines, ""])
        try:
            hidden = parse_settings(sealed.encode())
        except ValueError as error:
            raise ValueError(f"{settings}: no table can be added to it: {error}") from error
        if _flies(hidden):
            return sealed
    raise ValueError(
        f"{settings}: with what seed {seed} hides this craft does not fly; give another seed"
    )


def _flies(settings: StandInSettings) -> bool:
    """On its own gains; what falls down nobody can learn."""
    craft = StandIn(settings)
    for time_s in np.arange(0.1, FLOWN_S, 0.1):
        craft.advance(float(time_s))
        state = craft.state()
        if max(map(abs, state.angles_deg[:2])) > LEAN_DEG:
            return False
        if max(map(abs, state.gyro_dps)) > RATE_DPS:
            return False
    return True


if __name__ == "__main__":
    sys.exit(main())
