"""The thesis repeated: every table and figure with a counterpart, beside the printed one."""
