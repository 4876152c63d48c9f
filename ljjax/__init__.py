"""ljjax: simulate, identify, diagnose and control layer-jamming continuum robots."""
