"""The commands, one a module: its settings, which are the text of --help, and what it does with them."""
