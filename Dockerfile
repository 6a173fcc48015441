# cellmig with all that it needs, on Debian 13; with --build-arg DEBIAN=12 on Debian 12:
#   docker build -t cellmig .
#   docker run --rm -v "$PWD:/data" cellmig cases/one_cell.toml --until "40 us"     # results in output/ here
ARG DEBIAN=13
FROM debian:${DEBIAN}-slim
COPY . /opt/cellmig
RUN /opt/cellmig/run doctor && rm -rf /var/lib/apt/lists/*
ENV PATH="/opt/cellmig/.venv/bin:${PATH}"
WORKDIR /data
ENTRYPOINT ["/opt/cellmig/run"]
CMD ["--help"]
