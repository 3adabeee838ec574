# make: the controller as libraries of this computer. make check: compare them with the test vectors.
# make avr: the program of an ATmega2560 (needs gcc-avr and avr-libc, and the board's files).

CC ?= cc
HOST_FLAGS = -std=c99 -O2 -ffp-contract=off -fPIC
DOUBLE = -DCONTROLLER_DOUBLE
FLOAT = -fsingle-precision-constant
CONTROLLER = controller.c law.c
HEADERS = $(wildcard *.h)

AVR_FLAGS = -std=gnu99 -O2 -mmcu=atmega2560 -DF_CPU=16000000UL -ffunction-sections -fdata-sections
AVR_SOURCES = $(CONTROLLER) $(wildcard protocol.c board.c mega.c)

all: controller-double.so controller-float.so

controller-double.so: $(CONTROLLER) host.c $(HEADERS)
	$(CC) $(HOST_FLAGS) $(DOUBLE) -shared $(CONTROLLER) host.c -o $@ -lm

controller-float.so: $(CONTROLLER) host.c $(HEADERS)
	$(CC) $(HOST_FLAGS) $(FLOAT) -shared $(CONTROLLER) host.c -o $@ -lm

check: check-double check-float
	./check-double
	./check-float

check-double: $(CONTROLLER) check.c $(HEADERS)
	$(CC) $(HOST_FLAGS) $(DOUBLE) $(CONTROLLER) check.c -o $@ -lm

check-float: $(CONTROLLER) check.c $(HEADERS)
	$(CC) $(HOST_FLAGS) $(FLOAT) $(CONTROLLER) check.c -o $@ -lm

avr: firmware.hex

firmware.elf: $(AVR_SOURCES) $(HEADERS)
	avr-gcc $(AVR_FLAGS) -Wl,--gc-sections $(AVR_SOURCES) -o $@ -lm
	avr-size $@

firmware.hex: firmware.elf
	avr-objcopy -O ihex -R .eeprom $< $@

clean:
	rm -f controller-double.so controller-float.so check-double check-float firmware.elf firmware.hex

.PHONY: all check avr clean
