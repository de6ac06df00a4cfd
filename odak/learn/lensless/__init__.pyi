from .speckle_tracking import spec_track as spec_track
