"""The live page: worlds are built, robots driven and finished runs replayed in a browser."""
