"""The sealed test of ``discrepancy``: effects hidden by seed, found by a process that sees only
recordings and a model, judged when the seal is opened afterwards.

What is hidden and how it flies comes from ``firmware_sim`` alone; nothing here shares code with
what searches. ``python -m bench.sealed --help`` runs it.
"""
