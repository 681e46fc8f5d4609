"""Where all is put together: scene files, runner, metrics, reports, viewer and command line."""
