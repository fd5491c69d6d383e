"""What runs beside one robot: it owns that robot's safety and executes its tests."""
