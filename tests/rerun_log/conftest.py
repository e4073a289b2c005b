from support.packets import wobble, wobbling_flight

__all__ = ["wobble", "wobbling_flight"]
