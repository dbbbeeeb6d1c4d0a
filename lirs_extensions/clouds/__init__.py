"""Mappers of point clouds: `wheel_lio`, and adapters of other people's packages."""
