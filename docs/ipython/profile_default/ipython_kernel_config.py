"""The kernel of the tutorials is this machine's own: it need not warn of its plain connection."""

c = get_config()  # noqa: F821
c.IPKernelApp.log_level = 40
