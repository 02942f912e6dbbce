"""Files of several formats as columns: `read_record`."""
