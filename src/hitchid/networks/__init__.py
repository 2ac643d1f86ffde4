"""Recurrent networks that correct the physical models, and the operating range of the tests."""
