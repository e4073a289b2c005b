"""From packets to samples: codec, deduplication, time, batches, link statistics. Pure."""
