"""Crazyflies, through Bitcraze's cflib, over a Crazyradio, USB or UDP."""
