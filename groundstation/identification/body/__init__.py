"""Body constants and effects from flights in closed loop (thesis 7.3.6). Pure."""
