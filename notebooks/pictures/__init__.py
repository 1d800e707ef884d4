"""The pictures: a module for each notebook, a function for each picture."""
