"""Batches: many plans, on several processes or a cluster, kept as a dataset."""
