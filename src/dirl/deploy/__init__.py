"""A trained agent outside its scenes."""
