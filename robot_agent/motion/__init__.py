"""One motion from rest to rest, sample by sample, in time and watched."""
