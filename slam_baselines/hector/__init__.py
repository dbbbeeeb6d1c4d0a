"""HectorSLAM: scan-to-map matching by Gauss-Newton (Kohlbrecher et al. 2011)."""
