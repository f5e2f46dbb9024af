# The server on Mesa llvmpipe, no GPU needed: see docs/deploying.md for TLS, tokens and GPUs.
#   docker build -t glsplat .
#   docker run --rm -p 127.0.0.1:8000:8000 --shm-size 256m glsplat

FROM debian:12-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv && rm -rf /var/lib/apt/lists/*
COPY . /src
RUN python3 -m venv /opt/glsplat && /opt/glsplat/bin/pip install --no-cache-dir '/src[server]'

FROM debian:12-slim
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3 libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --create-home glsplat \
    && mkdir /etc/glsplat && echo 'log-format = "json"' > /etc/glsplat/server.toml
COPY --from=build /opt/glsplat /opt/glsplat
ENV PATH=/opt/glsplat/bin:$PATH PYTHONUNBUFFERED=1
USER 10001
WORKDIR /home/glsplat
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=60s CMD ["python3", "-c", \
    "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/healthz', timeout=4)"]
ENTRYPOINT ["glsplat"]
# --insecure: who reaches a container is decided by what is published, see -p above; beyond this machine give TLS and a token
CMD ["serve", "--host", "0.0.0.0", "--insecure", "--config", "/etc/glsplat/server.toml"]
