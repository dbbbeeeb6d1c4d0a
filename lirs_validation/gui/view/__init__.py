"""View of a page: scene and controls. Only this package uses viser."""
