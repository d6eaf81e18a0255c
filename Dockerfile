# The command in an image: docker build -t rigor . && docker run --rm -v "$PWD:/work" rigor run demo --clock virtual
# With docs/packages.md: what differs on hosts without real-time rights, and rights that a container can be given.
FROM debian:bookworm AS build
COPY . /src
WORKDIR /src
RUN ./dev package

FROM debian:bookworm-slim
COPY --from=build /src/build/packages /packages
RUN apt-get update && apt-get install -y --no-install-recommends python3 /packages/rigor_*.deb /packages/librigor0*.deb \
    $(find /packages -name 'python3-rigor_*.deb') && rm -rf /packages /var/lib/apt/lists/*
RUN useradd --create-home --uid 1000 rigor && mkdir /work && chown rigor /work
USER rigor
WORKDIR /work
ENTRYPOINT ["rigor"]
CMD ["--help"]
