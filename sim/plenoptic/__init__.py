"""The simulated plenoptic camera: light through a lenslet array onto a sensor, and into Lytro files.

It shares the layout of files (`lfrig.contracts.lytro`) with the decoder, and nothing else, so that one tests the other.
"""
