/* The hardware's part for the Arduino Mega 2560 (ATmega2560, 16 MHz). Change pins, zeros and signs here.

   Pin 0/1    the host, 500,000 baud, 8N1 (USB)
   Pin 20/21  SDA, SCL of the joint encoder, an AS5048B at address 0x40
   Pin A0/A1  wipers of the slide potentiometers: biceps, triceps
   Pin 11/12  servo pulses of the drives: biceps, triceps; a pulse in every control period (assumed: the paper does not
              name the drives' input; for other drives write `board_drive` in mega.c anew)
   Pin 13     high during a tick of the controller: measure it with an oscilloscope */
#ifndef MEGA_H
#define MEGA_H

#define BAUD_RATE 500000UL
#define ENCODER_ADDRESS 0x40
#define ENCODER_ZERO 0      /* counts of the encoder at a joint angle of 0 */
#define ENCODER_SIGN 1      /* -1 if the encoder counts down in flexion */
#define SLIDER_ZERO 0       /* counts of a potentiometer at rest */
#define PULSE_MIDDLE_US 1500 /* at a command of 0 */
#define PULSE_REACH_US 600   /* more or less at +-COMMAND_LIMIT */

void mega_begin(void);
void mega_loop(void);

#endif
