"""Every fault, by what it breaks."""

from bench.mutants import access, data, physics, proof, safety
from bench.mutants.fault import Fault

FAULTS: dict[str, tuple[Fault, ...]] = {
    "safety": safety.FAULTS,
    "data": data.FAULTS,
    "access": access.FAULTS,
    "units and signs": physics.FAULTS,
    "proof": proof.FAULTS,
}
