"""Running a server for others: status page, metrics, previews, history, certificates, QR codes."""

REQUIRES = ()
