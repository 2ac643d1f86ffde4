"""Published studies, carried out anew."""
