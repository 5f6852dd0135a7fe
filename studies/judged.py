"""Former names of `studies.used_frames`, for `studies.calibration` and `studies.tracing` until these are renamed."""

from studies.used_frames import WHY, Stretch, share_left_out, used_mask
from studies.used_frames import UsedFrames as Judged
from studies.used_frames import left_out_in_words as said

judged, share_unjudged = used_mask, share_left_out
__all__ = ["WHY", "Judged", "Stretch", "judged", "said", "share_unjudged"]
