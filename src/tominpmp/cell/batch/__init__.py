"""Batches: many plans, on several processes or a cluster, stored as a dataset."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
