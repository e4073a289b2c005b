"""The whole story in one command: the installed commands, run one after the other, and a report."""
