"""HTML reports: one self-contained file with text, tables and figures."""
