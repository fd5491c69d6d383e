"""What is believed of one robot's response, given its tests."""
