"""A fleet: many machines identified, compared and watched."""
