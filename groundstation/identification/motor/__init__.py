"""Motor constants from bench runs or from flights (thesis 7.2). Pure."""
