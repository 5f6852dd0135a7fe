"""Correctors: networks that learned from measured motions what a simulator leaves out. PyTorch is needed to train,
and for the network of the paper; `field` predicts with numpy."""

from corrector.load import load_corrector

__all__ = ["load_corrector"]
