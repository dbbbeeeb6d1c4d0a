"""Files of point clouds: PLY, LAS and LAZ, PCD."""
