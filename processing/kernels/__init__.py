"""Hot loops: each file holds one kernel's NumPy twin and the call of its C++ form in the ``.cpp`` beside it."""
