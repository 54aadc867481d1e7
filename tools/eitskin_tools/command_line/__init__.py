"""What every subcommand's arguments share: parsing, suggestions, files that are named, extras that are needed."""
