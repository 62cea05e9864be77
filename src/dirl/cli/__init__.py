"""What the commands share: starting quickly, refusing options before long imports, one-line errors."""
