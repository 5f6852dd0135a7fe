"""Recordings of depth cameras as laboratories have them: streams of depth images with intrinsics and stamps, from
RealSense bags, folders of images, npz stacks and MCAP. Belongs here: what reads such a file, and what a depth means."""
