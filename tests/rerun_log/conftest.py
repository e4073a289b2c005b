from support.packets import wobble
from support.packets import wobbling_flight as flight

__all__ = ["flight", "wobble"]
