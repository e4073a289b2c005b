"""ARX polynomials of one axis (thesis 7.3.7). Pure."""
