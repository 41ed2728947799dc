"""`python -m deepkoco.cli`."""

from deepkoco.cli.command_line import main

raise SystemExit(main())
