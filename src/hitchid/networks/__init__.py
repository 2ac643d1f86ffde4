"""Recurrent networks beside the physical models, and the range that their training covered."""
