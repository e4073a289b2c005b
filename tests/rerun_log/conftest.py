from wobbling_flights import flight, wobble

__all__ = ["flight", "wobble"]
