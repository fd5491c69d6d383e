"""What earlier runs left: a catalogue, tables and exports."""
